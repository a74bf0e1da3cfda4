"""`WorkLost`: work that was given to other processes or machines and did not come back."""


class WorkLost(RuntimeError):
    """A worker died; neither the input nor this code need be at fault. What was finished is kept: start again."""
