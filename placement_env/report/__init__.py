"""The deployment planning report and the paper's experiments."""
