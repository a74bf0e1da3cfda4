"""Learning: policies, Stable-Baselines3, training over many sites."""
