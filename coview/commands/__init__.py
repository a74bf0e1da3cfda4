"""The commands, a file each: arguments in, one function called, its result printed."""
