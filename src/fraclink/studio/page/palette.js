// The command palette: the buttons and fields of all steps, by name.
import {$, make, on} from './dom.js';
import {put} from './svg.js';

export function palette(app) {
  const box = $('palette'), input = $('palette-find'), list = $('palette-list');
  let found = [], at = 0;
  const name = (node) => (node.getAttribute('aria-label') || (node.querySelector('.word') || node.labels?.[0]?.querySelector('span')?.firstChild || node.labels?.[0] || node).textContent || node.title).trim();
  // the arm stands beside the loop, too, but there without its settings
  const step = (node) => (node.closest('.armbox') ? 'move' : node.closest('.step')?.id.slice(5));
  const mark = () => [...list.children].forEach((item, i) => {
    put(item, {'aria-selected': i === at});
    if (i === at) { put(input, {'aria-activedescendant': item.id}); item.scrollIntoView({block: 'nearest'}); }
  });
  const run = (node) => {
    box.close();
    if (step(node)) app.show(step(node));
    for (let open = node.closest('details'); open; open = open.parentElement.closest('details')) open.open = true;
    if (node.matches('input, select')) node.focus(); else node.click();
  };
  const fill = () => {
    const words = input.value.toLowerCase().split(/\s+/);
    found = [...document.querySelectorAll('button[id], .step input[id], .step select[id], .chip[data-name]')]
      .filter((node) => !node.closest('dialog') && !node.disabled && !node.closest('.step [hidden]'))
      .map((node) => [node, `${step(node) ? `${step(node)}: ` : ''}${name(node)}`])
      .filter(([, text]) => words.every((word) => text.toLowerCase().includes(word)));
    at = 0;
    list.replaceChildren();
    found.forEach(([node, text], i) => {
      const item = make('li', '', text, list);
      put(on(item, 'click', () => run(node)), {id: `p-${i}`, role: 'option'});
    });
    mark();
  };
  on(input, 'input', fill);
  on(input, 'keydown', (event) => {
    const by = {ArrowDown: 1, ArrowUp: -1}[event.key];
    if (by) { at = (at + by + found.length) % found.length; mark(); } else if (event.key === 'Escape') box.close(); else if (event.key === 'Enter') { if (found[at]) run(found[at][0]); } else return;
    event.preventDefault();
  });
  return () => { input.value = ''; fill(); box.showModal(); input.focus(); };
}
