"""Extension of Griffe for the documentation's site: types of attributes that docstrings list.

Griffe gives an attribute of unknown type the type of the attribute listed before it. Here such
a one has none.
"""

from typing import Any

import griffe


class AttributeTypes(griffe.Extension):
    """Takes the type of each attribute in a docstring from its own annotation, or from nothing."""

    def on_package(self, *, pkg: griffe.Module, **kwargs: Any) -> None:
        """Mend the docstrings of all classes of a package, once it is loaded."""
        mend(pkg)


def mend(place: griffe.Object) -> None:
    """Mend the docstrings of the classes in a module or a class."""
    for member in place.members.values():
        if isinstance(member, griffe.Class) and member.docstring:
            for section in member.docstring.parsed:
                if section.kind is griffe.DocstringSectionKind.attributes:
                    for attribute in section.value:
                        attribute.annotation = annotation(member, attribute.name)
        if isinstance(member, griffe.Module | griffe.Class):
            mend(member)


def annotation(owner: griffe.Class, name: str) -> Any:
    """Give the annotation of an attribute of a class, its own or of a base; None of none."""
    try:
        return owner[name].annotation
    except (AttributeError, KeyError):
        return None
