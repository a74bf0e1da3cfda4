"""Detection by several sensors."""
