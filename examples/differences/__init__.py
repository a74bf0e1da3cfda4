"""Fusion scheme whose messages hold only what changed since an earlier message."""
