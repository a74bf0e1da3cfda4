"""Reinforcement learning on the environments, with Stable-Baselines3."""
