"""What `reset(options=...)` may say, in every environment class."""

import difflib
from collections.abc import Mapping
from typing import Any

from bulletuav.errors import shown, unknown
from bulletuav.tasks.given import PLACES

MASK = "reset_mask"
"""Option that tells which worlds are reset, where there are several"""


def reset_options(options: Any, *also: str) -> dict[str, Any]:
    """Take what a reset's options say.

    Wrappers pass on options of their own, so names unlike all of ours are left alone.

    Args:
        options: A dict with "start" or "goal", (N, 3) m each, or None for nothing.
        also: Further names that it may have.

    Returns:
        Those that are asked for.

    Raises:
        ValueError: Options are neither a dict nor None, or have a name that is nearly one of ours.
    """
    if options is not None and not isinstance(options, Mapping):
        raise ValueError(
            f"options is {shown(options)}: a dict such as {{'start': positions}}, or None, is "
            f"needed"
        )
    given = dict(options or {})
    known = (*PLACES, *also)
    for name in given:
        if name not in known and difflib.get_close_matches(str(name), known):
            raise ValueError(f"options: {unknown('option of a reset', str(name), known)}")
    return {name: given[name] for name in known if given.get(name) is not None}
