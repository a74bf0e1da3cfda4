"""What a site's map alone says of its candidates: nothing is simulated, nothing rendered."""
