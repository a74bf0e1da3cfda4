"""What a set is worth: Shapley values, failures, margins."""
