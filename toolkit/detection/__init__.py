"""Detection by several sensors. Fusion schemes, the clustering detector, metrics and evaluation."""
