// The socket: requests by number, only the newest drag, and reconnection after a break.

export class Link {
  /** @param {(answer: any) => void} heard @param {(state: 'open' | 'lost' | 'refused') => void} changed */
  constructor(heard, changed) {
    this.heard = heard;
    this.changed = changed;
    this.seq = 0;
    this.waiting = new Map();
    this.next = null; // the newest drag, waiting for the one in progress
    this.dragging = false;
    this.tries = 0;
    this.busy = 0;
    this.token = location.hash.slice(1) || sessionStorage.getItem('studio') || '';
    sessionStorage.setItem('studio', this.token);
    // Removed from the address bar, where it would end up in screenshots and the history.
    history.replaceState(null, '', location.pathname);
    this.open();
  }

  open() {
    const socket = this.socket = new WebSocket(`ws://${location.host}/talk`);
    socket.binaryType = 'arraybuffer';
    socket.onopen = () => { socket.send(this.token); this.tries = 0; this.changed('open'); };
    socket.onmessage = (event) => this.receive(event.data);
    socket.onclose = (event) => {
      if (socket !== this.socket) return;
      for (const done of this.waiting.values()) done({ok: false, lost: true, error: 'not connected to the studio'});
      this.waiting.clear();
      this.sign();
      this.dragging = false;
      this.changed(event.code === 1008 ? 'refused' : 'lost');
      if (event.code !== 1008) setTimeout(() => this.open(), Math.min(5000, 300 * 2 ** this.tries++));
    };
  }

  receive(data) {
    const size = new DataView(data).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, size)));
    let at = 4 + size;
    const curves = {};
    for (const [name, [rows, count]] of Object.entries(head.curves)) {
      curves[name] = Array.from({length: rows}, () => { const row = new Float32Array(data, at, count); at += 4 * count; return row; });
    }
    head.curves = curves;
    const done = this.waiting.get(head.seq);
    if (done && head.verb !== 'progress') { this.waiting.delete(head.seq); this.sign(); done(head); } else this.heard(head);
  }

  /** @returns {Promise<any>} the answer, which may be a refusal */
  ask(verb, given = {}) {
    if (this.socket.readyState !== WebSocket.OPEN) return Promise.resolve({ok: false, lost: true, error: 'not connected to the studio'});
    const seq = ++this.seq;
    this.socket.send(JSON.stringify({seq, verb, ...given}));
    return new Promise((done) => { this.waiting.set(seq, done); this.sign(); });
  }

  /** The bar under the header shows a wait that is long enough to be noticed. */
  sign() {
    const root = document.documentElement;
    if (!this.waiting.size) { clearTimeout(this.busy); this.busy = 0; delete root.dataset.busy; }
    else this.busy ||= setTimeout(() => { root.dataset.busy = 'true'; }, 200);
  }

  /** One request is in progress, the newest waits, and those in between are dropped. `late` is called for one that takes long. */
  drag(given, shown, late) {
    this.next = [given, shown, late];
    if (!this.dragging) this.newest();
  }
  async newest() {
    this.dragging = Boolean(this.next);
    if (!this.next) return;
    const [given, shown, late] = this.next;
    this.next = null;
    const timer = setTimeout(late, 250);
    const answer = await this.ask('preview', given);
    clearTimeout(timer);
    this.newest(); // Python computes the next one while this one is drawn
    shown(answer);
  }
}

/** @param {Blob | File} file */
export async function upload(file, name, token) {
  const answer = await fetch(`/upload?name=${encodeURIComponent(name)}`, {method: 'POST', body: file, headers: {'X-Studio-Token': token}});
  return answer.ok ? '' : await answer.text();
}
