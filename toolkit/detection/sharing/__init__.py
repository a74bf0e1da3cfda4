"""Sharing within a budget: what each sensor sends when not everything fits its link."""
