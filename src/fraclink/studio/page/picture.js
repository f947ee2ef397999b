// A plot as a file: its drawing with the colours of the page written into it, its title and a legend.
import {make, saveAs} from './dom.js';
import {el, put} from './svg.js';

// The properties that a viewer needs from the page's style sheet.
const LOOK = ['fill', 'fill-opacity', 'stroke', 'stroke-width', 'stroke-opacity', 'stroke-dasharray', 'stroke-linejoin', 'opacity', 'paint-order', 'font-family', 'font-size', 'font-weight'];
const look = (node, shown) => put(node, Object.fromEntries(LOOK.map((name) => [name, getComputedStyle(shown).getPropertyValue(name)])));
const LINE = 16, SAMPLE = 22; // [pixels] height of a line of text, and length of a line in the legend
const SHARP = 2; // PNG pixels per pixel of the page, for print

/** The text of an SVG file: the title above the plot, the legend below. @param {import('./plot.js').Plot} plot */
function drawing({svg, W, height}, told, title) {
  const copy = svg.cloneNode(true), all = svg.querySelectorAll('*'), label = svg.querySelector('.frame text');
  copy.querySelectorAll('*').forEach((node, i) => look(node, all[i]));
  for (const node of copy.querySelectorAll('.handle, .reader')) node.remove();
  const words = (x, y, text) => look(el('text', {x, y}, copy, text), label);
  let x = LINE, y = height + LINE;
  for (const {name, path} of told) {
    const wide = SAMPLE + 8 * name.length + LINE; // a letter is narrower than 8 pixels
    if (x > LINE && x + wide > W) { x = LINE; y += LINE; }
    look(el('path', {d: `M${x} ${y - 4}h${SAMPLE}`}, copy), path);
    words(x + SAMPLE + 4, y, name);
    x += wide;
  }
  words(LINE, -4, title);
  const size = {width: W, height: y + 2 * LINE};
  copy.prepend(el('rect', {...size, y: -1.5 * LINE, fill: getComputedStyle(svg.closest('figure')).backgroundColor}));
  put(copy, {...size, viewBox: `0 ${-1.5 * LINE} ${size.width} ${size.height}`});
  return new XMLSerializer().serializeToString(copy);
}

async function painted(text) {
  const image = new Image(), canvas = make('canvas');
  image.src = `data:image/svg+xml,${encodeURIComponent(text)}`;
  await image.decode();
  Object.assign(canvas, {width: SHARP * image.width, height: SHARP * image.height});
  canvas.getContext('2d').drawImage(image, 0, 0, canvas.width, canvas.height);
  return new Promise((done) => { canvas.toBlob(done); });
}

/** Save a plot as an SVG or PNG file under its caption. */
export async function savePlot(plot, told, kind) {
  const caption = plot.svg.closest('figure').querySelector('figcaption').cloneNode(true);
  for (const part of caption.querySelectorAll('.tools, small, .key')) part.remove();
  const title = caption.textContent.replace(/\s+/g, ' ').trim();
  const text = drawing(plot, told, title), name = title.split(' [')[0].toLowerCase().replace(/\W+/g, '-');
  saveAs(kind === 'svg' ? new Blob([text], {type: 'image/svg+xml'}) : await painted(text), `${name}.${kind}`);
}
