"""What goes out: the deployment planning report, and the paper's experiments made again."""
