"""Detection by several sensors: fusion schemes, the clustering detector, metrics, evaluation."""
