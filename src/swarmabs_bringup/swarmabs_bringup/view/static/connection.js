// The WebSocket to the server: it comes back by itself, and silence counts as a lost connection.
const SILENCE = 4000; // ms; the server says something at least once a second
const FIRST_WAIT = 300;
const LONGEST_WAIT = 3000;
export const VERSION = 1;

export class Connection {
  // `take` gets each message, `status` gets "open" or "lost".
  constructor(take, status) {
    this.take = take;
    this.status = status;
    this.wait = FIRST_WAIT;
    this.heard = 0;
    this.open();
    setInterval(() => this.watch(), 500);
  }

  open() {
    const socket = new WebSocket(`ws://${location.host}/socket`);
    this.socket = socket;
    this.heard = performance.now();
    socket.onmessage = (event) => {
      if (socket !== this.socket) {
        return;
      }
      this.heard = performance.now();
      const message = JSON.parse(event.data);
      if (message.v !== VERSION) {
        this.status("other", message.v);
        return;
      }
      this.wait = FIRST_WAIT;
      this.status("open");
      this.take(message);
    };
    socket.onclose = () => {
      if (socket === this.socket) {
        this.again();
      }
    };
  }

  again() {
    this.status("lost");
    this.socket = null;
    setTimeout(() => this.open(), this.wait);
    this.wait = Math.min(this.wait * 2, LONGEST_WAIT);
  }

  watch() {
    if (this.socket && performance.now() - this.heard > SILENCE) {
      const silent = this.socket;
      this.again();
      silent.close();
    }
  }

  send(message) {
    if (this.socket && this.socket.readyState === WebSocket.OPEN) {
      this.socket.send(JSON.stringify({ v: VERSION, ...message }));
    }
  }
}
