// The WebSocket to the server. It reconnects by itself; silence counts as a lost connection.
const SILENCE = 4000; // ms; the server sends something at least once a second
const FIRST_WAIT = 300;
const LONGEST_WAIT = 3000;
const WHY = { 1008: "refused", 1009: "refused", 1013: "full" }; // close codes of the server
export const VERSION = 2;

export class Connection {
  // `take` receives each message; `status` receives "open", "lost", "refused" (the server rejected a message), "full"
  // (too many pages are connected) or "other" (with the protocol version of the server).
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
    socket.onclose = (event) => {
      if (socket === this.socket) {
        this.again(WHY[event.code]);
      }
    };
  }

  again(why = "lost") {
    this.status(why);
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

  // Return whether a connection was open to send on; delivery is not confirmed.
  send(message) {
    const open = this.socket !== null && this.socket.readyState === WebSocket.OPEN;
    if (open) {
      this.socket.send(JSON.stringify({ v: VERSION, ...message }));
    }
    return open;
  }
}
