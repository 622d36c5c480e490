"""Write the table of public names in docs/glossary.md: what `import eivor` offers, a line each.

python -m docs.public_names
"""

from __future__ import annotations

import inspect
import sys
from pathlib import Path

import eivor
from validation.pages import markdown, page_with

PAGE = Path(__file__).resolve().parent / "glossary.md"
PART = "public names"


def table() -> str:
    """Public names with the first line of what documents them."""
    rows = []
    for name in sorted(eivor.__all__, key=str.lower):
        thing = getattr(eivor, name)
        kind = "module" if inspect.ismodule(thing) else "class" if inspect.isclass(thing) else "function"
        line = (inspect.getdoc(thing) or "").partition("\n")[0]
        rows.append((f"`{name}`", kind, line.replace("|", "\\|")))
    return markdown(("name", "", "what it is"), [row for row in rows if not row[0].startswith("`__")])


if __name__ == "__main__":
    PAGE.write_text(page_with(PAGE.read_text(encoding="utf-8"), {PART: table()}), encoding="utf-8")
    sys.stdout.write(f"{PAGE}\n")
