// Pointer interaction in the figures of a page: values at a cursor that linked figures share, zooming into a
// window, and buttons that copy commands. A page is complete without this script.
(() => {
'use strict';
const ns = 'http://www.w3.org/2000/svg';
const WIDE = 4000, DEEP = 2000;
const make = (name, marks, parent) => {
  const e = document.createElementNS(ns, name);
  for (const k in marks) e.setAttribute(k, marks[k]);
  return parent.appendChild(e);
};
const scale = (text) => {
  const [low, high, log] = text.split(' ');
  const a = +low, b = +high;
  return log
    ? {at: (s) => a * Math.pow(b / a, s), share: (v) => Math.log(v / a) / Math.log(b / a), log: true}
    : {at: (s) => a + (b - a) * s, share: (v) => (v - a) / (b - a), log: false};
};
const text = (v) => {
  if (v === 0) return '0';
  const a = Math.abs(v);
  return (a >= 1e5 || a < 1e-4 ? v.toExponential(2) : String(+v.toPrecision(4))).replace('-', '−');
};
// The steps of a path written as "Mx yl dx dy dx dy ...", which has several parts if there are gaps.
const points = (d) => {
  const runs = [];
  for (const part of d.split('M').slice(1)) {
    const v = part.match(/-?\d+/g).map(Number);
    const run = [[v[0], v[1]]];
    for (let k = 2; k + 1 < v.length; k += 2) run.push([run.at(-1)[0] + v[k], run.at(-1)[1] + v[k + 1]]);
    runs.push(run);
  }
  return runs;
};
const height = (runs, x) => {
  for (const run of runs) {
    if (run[0][0] > x || run.at(-1)[0] < x) continue;
    let low = 0, high = run.length - 1;
    while (high - low > 1) { const m = (low + high) >> 1; if (run[m][0] <= x) low = m; else high = m; }
    const [a, b] = [run[low], run[high]];
    return b[0] === a[0] ? a[1] : a[1] + (b[1] - a[1]) * (x - a[0]) / (b[0] - a[0]);
  }
  return null;
};
const tip = document.body.appendChild(document.createElement('div'));
tip.id = 'tip'; tip.hidden = true; tip.setAttribute('aria-hidden', 'true');
const figures = [...document.querySelectorAll('svg.fl[data-x]')].map((svg) => {
  const x = scale(svg.dataset.x);
  const boxes = [...svg.querySelectorAll('svg.box')].map((box) => ({
    box, y: scale(box.dataset.y), top: +box.getAttribute('y'), deep: +box.getAttribute('height'),
    curves: [...box.querySelectorAll('path[d]:not(.dots):not([class^=b]):not([class^=l])')].map((path) => ({path, name: path.dataset.name || ''})),
  }));
  return {svg, x, boxes, link: svg.dataset.link, low: 0, high: 1, ticks: [...svg.querySelectorAll('text[x$="%"], line[x1$="%"], rect[width$="%"], svg[x$="%"]:not([x="100%"])')], lines: []};
});
const place = (figure, event) => {
  const own = figure.svg.getBoundingClientRect(), style = getComputedStyle(figure.svg);
  const left = own.left + parseFloat(style.paddingLeft);
  return (event.clientX - left) / (own.right - parseFloat(style.paddingRight) - left);
};
const clear = () => { for (const f of figures) { f.lines.forEach((line) => line.remove()); f.lines = []; } tip.hidden = true; };
const value = (figure, share) => figure.x.at(figure.low + share * (figure.high - figure.low));
const point = (figure, event) => {
  const share = place(figure, event);
  clear();
  if (share < 0 || share > 1) return;
  const at = value(figure, share);
  for (const other of figures) {
    const s = (other.x.share(at) - other.low) / (other.high - other.low);
    if (other.link !== figure.link || !(s >= 0 && s <= 1)) continue;
    for (const b of other.boxes) other.lines.push(make('line', {class: 'cursor', x1: 100 * s + '%', x2: 100 * s + '%', y1: b.top, y2: b.top + b.deep}, other.svg));
  }
  const down = event.clientY - figure.svg.getBoundingClientRect().top;
  const here = figure.boxes.find((b) => down >= b.top - 20 && down <= b.top + b.deep + 10) || figure.boxes[0];
  const rows = [text(at)], names = figure.boxes.flatMap((b) => b.curves.map((c) => [c.path.getAttribute('class').slice(0, 2), c.name]).filter((c) => c[1]));
  for (const curve of here.curves) {
    curve.runs ||= points(curve.path.getAttribute('d'));
    const y = height(curve.runs, (figure.low + share * (figure.high - figure.low)) * WIDE);
    if (y === null) continue;
    const style = curve.path.getAttribute('class').slice(0, 2);
    const name = curve.name || (names.find((n) => n[0] === style) || ['', ''])[1];
    rows.push(`${name ? name + ': ' : ''}${text(here.y.at(1 - y / DEEP))}`);
  }
  if (rows.length < 2) return;
  tip.textContent = rows.slice(0, 7).join('\n');
  tip.hidden = false;
  tip.style.left = Math.min(event.clientX + 14, innerWidth - tip.offsetWidth - 6) + 'px';
  tip.style.top = Math.min(event.clientY + 14, innerHeight - tip.offsetHeight - 6) + 'px';
};
// Positions are fractions of the width: the left edge of the window goes to 0 %, its right edge to 100 %.
const zoom = (figure, low, high) => {
  figure.low = low; figure.high = high;
  for (const b of figure.boxes) b.box.setAttribute('viewBox', `${low * WIDE} 0 ${(high - low) * WIDE} ${DEEP}`);
  for (const e of figure.ticks) {
    e.home ||= ['x', 'x1', 'x2', 'width'].filter((k) => (e.getAttribute(k) || '').endsWith('%')).map((k) => [k, parseFloat(e.getAttribute(k))]);
    let gone = false;
    for (const [k, v] of e.home) {
      if (e.tagName === 'text' && e.getAttribute('class') === 'axis') continue;
      if (k === 'x2' && v === 100 && e.home.length === 1) continue;
      const now = k === 'width' ? v / (high - low) : (v / 100 - low) / (high - low) * 100;
      if (k !== 'width' && e.tagName !== 'rect' && (now < -0.1 || now > 100.1)) gone = true;
      e.setAttribute(k, now + '%');
    }
    e.style.display = gone ? 'none' : '';
  }
};
for (const figure of figures) {
  if (!figure.boxes.some((b) => b.curves.length)) continue;
  let start = null, shade = null;
  figure.svg.style.cursor = 'crosshair';
  figure.svg.addEventListener('pointermove', (event) => {
    point(figure, event);
    if (start === null) return;
    const now = Math.min(Math.max(place(figure, event), 0), 1), b = figure.boxes;
    shade ||= make('rect', {class: 'window', y: b[0].top, height: b.at(-1).top + b.at(-1).deep - b[0].top}, figure.svg);
    shade.setAttribute('x', 100 * Math.min(start, now) + '%');
    shade.setAttribute('width', 100 * Math.abs(now - start) + '%');
  });
  figure.svg.addEventListener('pointerleave', clear);
  figure.svg.addEventListener('pointerdown', (event) => { if (event.pointerType === 'mouse' && !event.button) start = Math.min(Math.max(place(figure, event), 0), 1); });
  addEventListener('pointerup', (event) => {
    if (start === null) return;
    const end = Math.min(Math.max(place(figure, event), 0), 1), [a, b] = [Math.min(start, end), Math.max(start, end)], wide = figure.high - figure.low;
    start = null;
    if (shade) { shade.remove(); shade = null; }
    if (b - a > 0.02) for (const other of figures) if (other.link === figure.link && other.svg.dataset.x === figure.svg.dataset.x) zoom(other, figure.low + a * wide, figure.low + b * wide);
  });
  figure.svg.addEventListener('dblclick', () => { for (const other of figures) if (other.link === figure.link) zoom(other, 0, 1); });
}
// On paper, what is folded follows the rest as an appendix.
const main = document.querySelector('main');
let appendix = null;
addEventListener('beforeprint', () => {
  appendix = main.appendChild(document.createElement('section'));
  appendix.id = 'appendix';
  appendix.append(Object.assign(document.createElement('h2'), {textContent: 'Appendix: the folded parts of the page'}));
  for (const section of main.querySelectorAll('section[id]')) {
    const folded = [...section.querySelectorAll('details:not([open])')].filter((one) => !one.closest('.map, .armbox'));
    if (folded.length) appendix.append(section.querySelector('h2').cloneNode(true));
    for (const details of folded) {
      const copy = appendix.appendChild(document.createElement('div'));
      copy.home = details;
      details.classList.add('moved');
      copy.append(Object.assign(document.createElement('h3'), {textContent: details.firstElementChild.textContent}), ...[...details.childNodes].slice(1));
    }
  }
});
addEventListener('afterprint', () => {
  for (const copy of appendix.querySelectorAll('div')) {
    if (!copy.home) continue;
    copy.home.append(...[...copy.childNodes].slice(1));
    copy.home.classList.remove('moved');
  }
  appendix.remove();
});
for (const box of document.querySelectorAll('.command')) {
  const button = box.appendChild(document.createElement('button'));
  button.type = 'button'; button.textContent = 'Copy';
  button.addEventListener('click', async () => {
    const words = box.querySelector('code').textContent;
    try { await navigator.clipboard.writeText(words); } catch { getSelection().selectAllChildren(box.querySelector('code')); document.execCommand('copy'); }
    button.textContent = 'Copied';
    setTimeout(() => { button.textContent = 'Copy'; }, 1500);
  });
}
})();
