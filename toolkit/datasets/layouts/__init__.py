"""Foreign recordings of clouds, one file per layout. Each file also names the layout's traps."""
