// A button that copies the code beside it; prompts are left out.
'use strict';
for (const box of document.querySelectorAll('div.highlight')) {
  const pre = box.querySelector('pre');
  if (!pre || !pre.textContent.trim() || box.closest('.cell_output, .output')) continue;
  const button = document.createElement('button');
  button.type = 'button';
  button.className = 'copy';
  button.textContent = 'Copy';
  button.addEventListener('click', async () => {
    const lines = pre.textContent.replace(/\n$/, '').split('\n');
    const prompts = lines.filter((line) => /^(\$|>>>|\.\.\.) /.test(line));
    const text = (prompts.length ? prompts.map((line) => line.replace(/^(\$|>>>|\.\.\.) /, '')) : lines).join('\n');
    try {
      await navigator.clipboard.writeText(text);
    } catch { // a page opened from a file has no clipboard of its own
      getSelection().selectAllChildren(pre);
      document.execCommand('copy');
    }
    button.textContent = 'Copied';
    setTimeout(() => { button.textContent = 'Copy'; }, 1500);
  });
  box.append(button);
}
