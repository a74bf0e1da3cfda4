"""Several searches together, judged by a more accurate fidelity on traffic that none of them saw."""

from typing import TYPE_CHECKING

from toolkit.runtime.lazy import lazily

if not TYPE_CHECKING:
    __getattr__, __dir__, __all__ = lazily(__name__, {})
