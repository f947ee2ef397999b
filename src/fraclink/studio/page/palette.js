// The command palette: the buttons and fields of all steps, by name.
import {$, button, emptied, make, on} from './dom.js';

export function palette(app) {
  const box = $('palette'), input = $('palette-find'), list = $('palette-list');
  const name = (node) => (node.getAttribute('aria-label') || (node.querySelector('.word') || node.labels?.[0]?.querySelector('span')?.firstChild || node.labels?.[0] || node).textContent || node.title).trim();
  // the arm stands beside the loop, too, but there without its settings
  const step = (node) => (node.closest('.armbox') ? 'move' : node.closest('.step')?.id.slice(5));
  const run = (node) => {
    box.close();
    if (step(node)) app.show(step(node));
    for (let open = node.closest('details'); open; open = open.parentElement.closest('details')) open.open = true;
    if (node.matches('input, select')) node.focus(); else node.click();
  };
  const fill = () => {
    const words = input.value.toLowerCase().split(/\s+/);
    emptied(list);
    for (const node of document.querySelectorAll('button[id], .step input[id], .step select[id], .chip[data-name]')) {
      const text = `${step(node) ? `${step(node)}: ` : ''}${name(node)}`, hidden = node.closest('dialog') || node.disabled || node.closest('.step [hidden]');
      if (!hidden && words.every((word) => text.toLowerCase().includes(word))) button(text, '', make('li', '', '', list), () => run(node));
    }
  };
  on(input, 'input', fill);
  on(box, 'keydown', (event) => {
    const all = [input, ...list.querySelectorAll('button')], at = all.indexOf(event.target), by = {ArrowDown: 1, ArrowUp: -1}[event.key];
    if (by) all.at((at + by) % all.length).focus();
    else if (event.key === 'Enter' && !at) all[1]?.click();
    else if (event.key === 'Escape') box.close(); // at once, though the field has a text
    else return;
    event.preventDefault();
  });
  return () => { input.value = ''; fill(); box.showModal(); input.focus(); };
}
