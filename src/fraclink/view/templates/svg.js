// Elements, paths and round numbers of drawings in screen pixels, for the studio and for the page of the arm.

/** Set attributes of an element by their names. */
export const put = (node, given) => { for (const key in given) node.setAttribute(key, given[key]); return node; };
/** Create an element of a drawing. */
export const el = (name, attributes = {}, parent = null, text = '') => {
  const made = put(document.createElementNS('http://www.w3.org/2000/svg', name), attributes);
  if (text) made.textContent = text;
  if (parent) parent.append(made);
  return made;
};
export const limited = (v, low, high) => Math.min(high, Math.max(low, v));
export const degrees = (radians) => (radians * 180) / Math.PI;
export const tenth = (v) => v.toFixed(1);
/** A number in that many significant digits. */
export const plain = (v, places = 4) => {
  if (v === null || !Number.isFinite(v)) return '–';
  const text = Math.abs(v) >= 1e5 || (v && Math.abs(v) < 1e-4) ? v.toExponential(places - 1) : String(Number(v.toPrecision(places)));
  return text.replace('-', '−');
};

/** The path through `count` points, without those less than a tenth of a pixel off the straight line so far; NaN is a gap. */
export const pathOf = (count, X, Y) => {
  // rounded to tenths: toFixed took half of the time of a drag
  const parts = [], add = (pen, x, y) => parts.push(pen, Math.round(10 * x) / 10, ' ', Math.round(10 * y) / 10);
  // the last point drawn, the direction of the line from there, and the previous point
  let fromX = NaN, fromY = NaN, alongX = NaN, alongY = NaN, atX = NaN, atY = NaN;
  for (let i = 0; i <= count; i++) { // past the end is a gap, too
    const x = i < count ? X(i) : NaN, y = i < count ? limited(Y(i), -3e3, 3e3) : NaN, gap = !(x === x && y === y), begins = !gap && atX !== atX;
    const ahead = (x - atX) * alongX + (y - atY) * alongY >= 0, aside = Math.abs((x - fromX) * alongY - (y - fromY) * alongX);
    if (begins) add('M', x, y);
    else if (!(ahead && aside < 0.1)) {
      if (alongX === alongX) add('L', atX, atY);
      [fromX, fromY] = [atX, atY];
      const size = Math.hypot(x - atX, y - atY);
      [alongX, alongY] = [(x - atX) / size, (y - atY) / size];
    }
    [atX, atY] = gap ? [NaN, NaN] : [x, y];
  }
  return parts.join('');
};
/** The path through a list of points. */
export const line = (points) => pathOf(points.length, (i) => points[i][0], (i) => points[i][1]);

/** The next round number. */
export const roundUp = (v) => {
  const power = 10 ** Math.floor(Math.log10(v));
  return [1, 2, 2.5, 5, 10].find((step) => step * power >= v) * power;
};
/** About `count` multiples of a round number. */
export const steps = (low, high, count) => {
  const step = roundUp((high - low) / count), first = Math.ceil(low / step - 1e-9), last = Math.floor(high / step + 1e-9);
  return Array.from({length: last - first + 1}, (_, i) => step * (first + i));
};
/** The functions from a value of an axis to its position between two ends, and back. */
export const scaleOf = ({low, high, log}, from, to) => {
  const [f, inverse] = log ? [Math.log, Math.exp] : [(v) => v, (v) => v], origin = f(low), k = (to - from) / (f(high) - origin);
  return [(v) => from + k * (f(v) - origin), (place) => inverse(origin + (place - from) / k)];
};
