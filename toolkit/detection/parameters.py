"""`Parameters`: base of codecs and schemes that depend only on their fields."""


class Parameters:
    """Base of dataclasses whose behaviour depends only on their fields."""

    @property
    def digest(self) -> str:
        """Name of the class and its parameters (`repr`), which is the key of cached results."""
        return repr(self)
