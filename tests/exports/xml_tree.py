"""XML as a tree, for tests that count on every element's place."""

from __future__ import annotations

from dataclasses import dataclass, field
from xml.parsers import expat


@dataclass
class Element:
    """An element; comments and blanks between elements are left out."""

    name: str
    attributes: dict[str, str] = field(default_factory=dict)
    children: list[Element] = field(default_factory=list)
    text: str = ""

    def __getitem__(self, position: int) -> Element:
        return self.children[position]

    def all(self, name: str) -> list[Element]:
        """Its children of a name."""
        return [child for child in self.children if child.name == name]

    def one(self, path: str) -> Element:
        """The only child of each name on the path."""
        result = self
        for name in path.split("/"):
            (result,) = result.all(name)
        return result

    def numbers(self, path: str) -> list[float]:
        """Numbers in the text of the only child on the path."""
        return [float(word) for word in self.one(path).text.split()]


def xml_tree(text: str) -> Element:
    """Root of a document without declarations of its own."""
    top = Element("")
    within = [top]
    parser = expat.ParserCreate()

    def start(name: str, attributes: dict[str, str]) -> None:
        within[-1].children.append(Element(name, attributes))
        within.append(within[-1].children[-1])

    def letters(data: str) -> None:
        within[-1].text += data.strip()

    def declaration(*_: object) -> None:
        raise AssertionError("a document type, which no file of ours has")

    parser.StartElementHandler, parser.EndElementHandler = start, lambda _: within.pop()
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = letters, declaration
    parser.buffer_text = True
    parser.Parse(text, True)
    (root,) = top.children
    return root
