"""The commands, a file each in the room of its group: arguments in, one function called, its result
printed."""
