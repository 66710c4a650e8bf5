"""A griffe extension: comments behind the fields of a class, or above them, make its list of attributes."""

from typing import Any

from griffe import Attribute, Class, Docstring, Extension


class TrailingComments(Extension):
    """Fields of public classes are described in comments, as in `tip_angle: ...  # phi(L), rad`."""

    def on_class(self, *, cls: Class, **_: Any) -> None:
        """Add them to the docstring of the class, in Google form."""
        described = {name: comment for name, field in cls.attributes.items() if (comment := comment_of(field))}
        if described and cls.docstring is not None:
            lines = [f"    {name}: {comment}" for name, comment in described.items()]
            text = "\n".join([cls.docstring.value, "", "Attributes:", *lines])
            cls.docstring = Docstring(text, lineno=cls.docstring.lineno, parent=cls)


def comment_of(field: Attribute) -> str:
    """The comment behind a public field, else the line above it where that is one."""
    if field.is_alias or field.docstring is not None or field.name.startswith("_") or field.lineno is None:
        return ""
    lines = field.lines_collection[field.filepath]
    above = lines[field.lineno - 2].strip()
    return lines[(field.endlineno or field.lineno) - 1].partition("  # ")[2] or (above[2:] if above[:2] == "# " else "")
