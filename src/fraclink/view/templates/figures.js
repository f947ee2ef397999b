// Pointer interaction in the figures of a page: values at a cursor that linked figures share, zooming into a
// window, and buttons that copy commands. A page is complete without this script.

const WIDE = 4000, DEEP = 2000; // steps of the drawing in a panel
// The share of an axis at which a value lies, and back.
const scale = (text) => {
  const [low, high, log] = text.split(' ');
  return scaleOf({low: Number(low), high: Number(high), log}, 0, 1);
};
// The points of a path written as "Mx yl dx dy dx dy ...", in several parts if there are gaps.
const partsOf = (d) => d.split('M').slice(1).map((part) => {
  const numbers = part.match(/-?\d+/g), points = [];
  for (let k = 0, x = 0, y = 0; k + 1 < numbers.length; k += 2) points.push([x += Number(numbers[k]), y += Number(numbers[k + 1])]);
  return points;
});
const height = (parts, x) => {
  const part = parts.find((points) => points[0][0] <= x && points.at(-1)[0] >= x);
  if (!part) return null;
  const next = Math.max(1, part.findIndex((point) => point[0] >= x)), [[ax, ay], [bx, by]] = [part[next - 1], part[next] || part[0]];
  return bx === ax ? ay : ay + ((by - ay) * (x - ax)) / (bx - ax);
};
// What moves when the figure is zoomed, with its positions as shares of the width.
const marksOf = (svg) => [...svg.querySelectorAll('[x$="%"]:not(.axis, [x="100%"]), [x1$="%"]')].map((node) => {
  const keys = ['x', 'x1', 'x2', 'width'].filter((key) => node.getAttribute(key)?.endsWith('%'));
  return {node, shares: keys.map((key) => [key, parseFloat(node.getAttribute(key)) / 100])};
});
const figures = [...document.querySelectorAll('svg.fl[data-x]')].map((svg) => {
  const boxes = [...svg.querySelectorAll('svg.box')].map((box) => ({
    box, y: scale(box.dataset.y), top: Number(box.getAttribute('y')), deep: Number(box.getAttribute('height')),
    curves: [...box.querySelectorAll('path[d]:not(.dots):not([class^=b]):not([class^=l])')].map((path) => (
      {style: path.getAttribute('class').slice(0, 2), name: path.dataset.name || '', d: path.getAttribute('d')}
    )),
  }));
  return {svg, boxes, x: scale(svg.dataset.x), link: svg.dataset.link, low: 0, high: 1, marks: marksOf(svg), lines: []};
});
const tip = document.body.appendChild(document.createElement('div'));
put(tip, {id: 'tip', 'aria-hidden': true}).hidden = true;

// The pointer as a share of the width.
const place = ({svg}, event) => {
  const own = svg.getBoundingClientRect(), {paddingLeft, paddingRight} = getComputedStyle(svg), left = own.left + parseFloat(paddingLeft);
  return (event.clientX - left) / (own.right - parseFloat(paddingRight) - left);
};
const clear = () => {
  for (const {lines} of figures) for (const line of lines.splice(0)) line.remove();
  tip.hidden = true;
};
const point = (figure, event) => {
  const {boxes, link, low, high} = figure, share = place(figure, event), across = low + share * (high - low), at = figure.x[1](across);
  clear();
  if (share < 0 || share > 1) return;
  for (const other of figures) {
    const there = (100 * (other.x[0](at) - other.low)) / (other.high - other.low);
    if (other.link !== link || !(there >= 0 && there <= 100)) continue;
    for (const {top, deep} of other.boxes) other.lines.push(el('line', {class: 'cursor', x1: `${there}%`, x2: `${there}%`, y1: top, y2: top + deep}, other.svg));
  }
  const down = event.clientY - figure.svg.getBoundingClientRect().top, rows = [plain(at)];
  const here = boxes.find(({top, deep}) => down >= top - 20 && down <= top + deep + 10) || boxes[0];
  // only one panel names the curves of a style
  const names = Object.fromEntries(boxes.flatMap(({curves}) => curves).filter(({name}) => name).map(({style, name}) => [style, name]));
  for (const curve of here.curves) {
    const y = height(curve.parts ||= partsOf(curve.d), across * WIDE), name = curve.name || names[curve.style];
    if (y !== null) rows.push(`${name ? `${name}: ` : ''}${plain(here.y[1](1 - y / DEEP))}`);
  }
  if (rows.length < 2) return;
  tip.textContent = rows.slice(0, 7).join('\n');
  tip.hidden = false;
  tip.style.left = `${Math.min(event.clientX + 14, innerWidth - tip.offsetWidth - 6)}px`;
  tip.style.top = `${Math.min(event.clientY + 14, innerHeight - tip.offsetHeight - 6)}px`;
};
// The left end of the window goes to 0 %, its right end to 100 %.
const zoom = (figure, low, high) => {
  Object.assign(figure, {low, high});
  for (const {box} of figure.boxes) put(box, {viewBox: `${low * WIDE} 0 ${(high - low) * WIDE} ${DEEP}`});
  for (const {node, shares} of figure.marks) {
    for (const [key, share] of shares) put(node, {[key]: `${(100 * (key === 'width' ? share : share - low)) / (high - low)}%`});
    const [[, first]] = shares, seen = node.tagName === 'rect' || (first >= low && first <= high);
    node.style.display = seen ? '' : 'none';
  }
};
let drag = null; // the window that is drawn: its figure, the share where it begins, and its shade
for (const figure of figures.filter(({boxes}) => boxes.some(({curves}) => curves.length))) {
  const {svg, boxes} = figure, [{top}] = boxes, last = boxes.at(-1);
  svg.style.cursor = 'crosshair';
  svg.addEventListener('pointermove', (event) => {
    point(figure, event);
    if (drag?.figure !== figure) return;
    const now = limited(place(figure, event), 0, 1);
    drag.shade ||= el('rect', {class: 'window', y: top, height: last.top + last.deep - top}, svg);
    put(drag.shade, {x: `${100 * Math.min(drag.from, now)}%`, width: `${100 * Math.abs(now - drag.from)}%`});
  });
  svg.addEventListener('pointerleave', clear);
  svg.addEventListener('pointerdown', (event) => {
    if (event.pointerType === 'mouse' && !event.button) drag = {figure, from: limited(place(figure, event), 0, 1)};
  });
  svg.addEventListener('dblclick', () => { for (const other of figures) if (other.link === figure.link) zoom(other, 0, 1); });
}
addEventListener('pointerup', (event) => {
  if (!drag) return;
  const {figure, from, shade} = drag, [a, b] = [from, limited(place(figure, event), 0, 1)].sort((u, v) => u - v), {low, high} = figure;
  drag = null;
  shade?.remove();
  if (b - a < 0.02) return;
  for (const other of figures) {
    if (other.link === figure.link && other.svg.dataset.x === figure.svg.dataset.x) zoom(other, low + a * (high - low), low + b * (high - low));
  }
});

// On paper, what is folded follows the rest as an appendix.
const main = document.querySelector('main'), appendix = document.createElement('section'), moved = [];
appendix.id = 'appendix';
addEventListener('beforeprint', () => {
  appendix.replaceChildren(document.createElement('h2'));
  appendix.firstChild.textContent = 'Appendix: the folded parts of the page';
  for (const section of main.querySelectorAll('section[id]')) {
    const folded = [...section.querySelectorAll('details:not([open])')].filter((one) => !one.closest('.armbox'));
    if (folded.length) appendix.append(section.querySelector('h2').cloneNode(true));
    for (const details of folded) {
      const left = document.createElement('p');
      left.className = 'note';
      left.textContent = `${details.firstElementChild.textContent}: see the appendix`;
      details.replaceWith(left);
      details.open = true;
      appendix.append(details);
      moved.push([left, details]);
    }
  }
  main.append(appendix);
});
addEventListener('afterprint', () => {
  for (const [left, details] of moved.splice(0)) {
    details.open = false;
    left.replaceWith(details);
  }
  appendix.remove();
});
for (const box of document.querySelectorAll('.command')) {
  const code = box.querySelector('code'), button = box.appendChild(document.createElement('button'));
  const said = (text) => { button.textContent = text; };
  button.type = 'button';
  said('Copy');
  button.addEventListener('click', async () => {
    getSelection().selectAllChildren(code); // without a clipboard it can be copied by hand
    await navigator.clipboard.writeText(code.textContent);
    said('Copied');
    setTimeout(said, 1500, 'Copy');
  });
}
