// Elements of the page: find, create and listen to them.

import {put} from './svg.js';

export const $ = (id) => document.getElementById(id);
/** Create an element with text; text from a file is never parsed as markup. */
export const make = (name, kind = '', text = '', parent = null) => {
  const made = document.createElement(name);
  if (kind) made.className = kind;
  if (text) made.textContent = text;
  if (parent) parent.append(made);
  return made;
};
/** A sentence with a capital. */
export const capital = (text) => text[0].toUpperCase() + text.slice(1);
/** Set a property only if it differs: the same text again would cost a layout. */
export const change = (node, key, value) => { if (node[key] !== value) node[key] = value; };
/** Set the text of the element with that id. */
export const say = (id, text) => change($(id), 'textContent', text);
/** Listen to an element, or to the one with that id. */
export const on = (node, types, heard) => {
  const found = typeof node === 'string' ? $(node) : node;
  for (const type of types.split(' ')) found.addEventListener(type, heard);
  return found;
};
/** Remove all children of an element, or of the one with that id. */
export const emptied = (node) => {
  const found = typeof node === 'string' ? $(node) : node;
  found.replaceChildren();
  return found;
};
export const button = (text, kind, parent, click, label = '') => {
  const made = make('button', kind, text, parent);
  made.type = 'button';
  if (label) put(made, {'aria-label': label});
  return on(made, 'click', click);
};
/** Fill an existing select with names. */
export const choices = (select, names, chosen) => {
  for (const name of new Set([chosen, ...names])) if (name !== undefined) make('option', '', name || '–', select).value = name;
  select.value = chosen;
  return select;
};
/** Accept whatever is dropped on the element. */
export const takes = (node, drop) => {
  on(node, 'dragenter dragover', (event) => { event.preventDefault(); node.classList.add('over'); });
  on(node, 'dragleave drop', () => node.classList.remove('over'));
  on(node, 'drop', (event) => { event.preventDefault(); drop(event.dataTransfer); });
};
/** Create an element with a name whose index, as in k_d, is set below the line. */
export const symbol = (kind, name, parent) => {
  const [, letter, index] = name.match(/^(\S+)_(\w)$/) || ['', name], made = make(kind, '', letter, parent);
  if (index) make('sub', '', index, made);
  return made;
};
/** Fill a table with cells from Python. */
export function table(place, header, rows, caption = '') {
  emptied(place);
  if (!rows || !rows.length) return;
  // a table wider than the window scrolls within itself, also by the keyboard
  put(place, {'tabindex': '0', 'role': 'region', 'aria-label': caption || header.join(', ')});
  const made = make('table', '', '', place);
  if (caption) make('caption', '', caption, made);
  const top = make('tr', '', '', make('thead', '', '', made));
  for (const cell of header) make('th', '', cell, top).scope = 'col';
  const body = make('tbody', '', '', made);
  for (const row of rows) {
    const line = make('tr', '', '', body);
    row.forEach((cell, i) => {
      const word = i === row.length - 1 ? {'✓': 'good', '✗': 'bad', '!': 'fair'}[cell[0]] || '' : '';
      if (i) make('td', word, cell, line);
      else symbol('th', cell, line).scope = 'row';
    });
  }
}
export function findings(place, list) {
  emptied(place);
  for (const {severity, code, message, remedy} of list || []) {
    const item = make('li', severity, '', place);
    if (code) make('b', '', `${code} `, item);
    item.append(code ? `${message}.` : message); // an error without a code is a whole sentence
    if (remedy) make('span', 'remedy', ` ${capital(remedy)}.`, item);
  }
}
/** Hand a file to the browser, which saves it as a download. */
export function saveAs(content, name) {
  const link = Object.assign(document.createElement('a'), {href: URL.createObjectURL(content), download: name});
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
