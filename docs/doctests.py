"""Shows ``>>>`` lines of docstrings as the programs they are; mkdocstrings takes them for quotes."""

import re

from griffe import Extension

LINES = re.compile(r"(?:^ *>>> .*\n?(?:^ *\.\.\. .*\n?)*)+", re.M)


def _fenced(match):
    lines = [re.sub(r"^ *(?:>>>|\.\.\.) ", "", line) for line in match[0].splitlines()]
    return "\n".join(["```python", *lines, "```", ""])


class Doctests(Extension):
    """Changes docstrings as they are read."""

    def on_object(self, *, obj, **kwargs):
        """Of modules, classes, functions and attributes."""
        if obj.docstring:
            obj.docstring.value = LINES.sub(_fenced, obj.docstring.value)
