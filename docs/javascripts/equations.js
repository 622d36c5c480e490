// KaTeX draws every equation in place of its source.
for (const place of document.querySelectorAll(".arithmatex")) {
  const source = place.textContent;
  katex.render(source.slice(2, -2), place, { displayMode: source.startsWith("\\["), throwOnError: false });
}
