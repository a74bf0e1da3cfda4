"""What the layouts read with: fields of records, labels made objects, clouds, and our own file of boxes."""
