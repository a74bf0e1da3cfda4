"""`Method`: location of a search and what it needs."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Method:
    """Location of a search.

    Attributes:
        module: Module of the search.
        function: Function in that module.
        needs: Required package, "" for none.
        extra: Extra of this project that installs the package.
        resumes: Whether the search takes a checkpoint.
    """

    module: str
    function: str = "search"
    needs: str = ""
    extra: str = "search"
    resumes: bool = False
