// What is wrong with how a page looks, in sentences: text outside of the window or of its picture, text over text,
// letters that are too small, canvases without a picture.
() => {
  const found = [];
  const width = document.documentElement.clientWidth;
  if (document.documentElement.scrollWidth > width) found.push(`the page is ${document.documentElement.scrollWidth} wide in a window of ${width}`);
  const boxes = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const owner = node.parentElement;
    const words = node.textContent.trim();
    if (!words || owner.closest("script, style, .unseen, .skip, .u-legend, noscript, svg title")) continue;
    const head = owner.closest("thead");
    if (head && getComputedStyle(head).clipPath !== "none") continue;
    if (!owner.checkVisibility({ contentVisibilityAuto: true })) continue;
    const svg = owner.closest("svg");
    const scroller = owner.closest("details .table");
    const range = document.createRange();
    range.selectNodeContents(node);
    for (const box of range.getClientRects()) {
      if (box.width < 1 || box.height < 1) continue;
      const whose = `"${words.slice(0, 40)}"`;
      if (box.left < -0.5 || box.right > width + 0.5) found.push(`${whose} goes from ${box.left.toFixed(0)} to ${box.right.toFixed(0)} in a window of ${width}`);
      if (svg) {
        const around = svg.getBoundingClientRect();
        if (box.left < around.left - 1 || box.right > around.right + 1 || box.top < around.top - 1 || box.bottom > around.bottom + 1) found.push(`${whose} leaves its picture`);
        if (box.height < 10) found.push(`${whose} is ${box.height.toFixed(1)} pixels high`);
      } else if (parseFloat(getComputedStyle(owner).fontSize) < 12) found.push(`${whose} is small`);
      if (!scroller) boxes.push({ box, whose, node });
    }
  }
  boxes.sort((one, other) => one.box.top - other.box.top);
  boxes.forEach((one, place) => {
    for (let next = place + 1; next < boxes.length && boxes[next].box.top < one.box.bottom - 2; next += 1) {
      const other = boxes[next];
      if (other.node === one.node) continue;
      const across = Math.min(one.box.right, other.box.right) - Math.max(one.box.left, other.box.left);
      const down = Math.min(one.box.bottom, other.box.bottom) - Math.max(one.box.top, other.box.top);
      const low = 0.3 * Math.min(one.box.height, other.box.height);
      if (across > 1 && down > low) found.push(`${one.whose} lies over ${other.whose}`);
    }
  });
  const copy = document.createElement("canvas");
  const small = copy.getContext("2d", { willReadFrequently: true });
  for (const canvas of document.querySelectorAll("canvas")) {
    [copy.width, copy.height] = [300, 100];
    small.drawImage(canvas, 0, 0, 300, 100);
    const { data } = small.getImageData(0, 0, 300, 100);
    let drawn = 0;
    for (let place = 3; place < data.length; place += 4) drawn += data[place] > 0;
    if (drawn < 300) found.push("a canvas is blank");
  }
  return found;
}
