"""Help texts that are composed when they are printed."""

from collections.abc import Callable


class DeferredHelp(str):
    """A help text that takes slow imports to compose.

    Completion of words, which describes options by `str`, shows the name of the function instead.

    Attributes:
        compose: Function that returns the text.
    """

    compose: Callable[[], str]

    def __new__(cls, compose: Callable[[], str]) -> "DeferredHelp":
        """Wrap a function; it can be used as a decorator."""
        text = super().__new__(cls, compose.__name__.strip("_").replace("_", " "))
        text.compose = compose
        return text
