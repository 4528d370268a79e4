// Playback of a bag: buttons, slider, speed, keys.
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10, 25, 50, 100];
const HOLD = 300; // ms for which a requested step is kept during playback
const PATIENCE = 2000; // ms for which it is kept while paused, and for which a requested speed is

const ADDRESS = 500; // ms between two updates of the time in the address

// The time in the address, s, as in #t=12.3; null if there is none.
function addressed() {
  const given = new URLSearchParams(location.hash.slice(1)).get("t");
  return given !== null && /^\d+(\.\d*)?$/.test(given) ? Number(given) : null;
}

const element = (id) => document.getElementById(id);

// Return whether a key scrolls the focused part of the page.
function scrolls(target, key) {
  const place = target.closest(".scroll, .events");
  if (!place) {
    return false;
  }
  const down = (key === "Home" || key === "End") && place.scrollHeight > place.clientHeight;
  return down || (key.startsWith("Arrow") && place.scrollWidth > place.clientWidth);
}

export class Controls {
  constructor(send) {
    this.send = send;
    this.enabled = false;
    this.lost = false;
    this.playing = false;
    this.step = 0; // the step shown, or the one requested
    this.last = 0;
    this.asked = -1e9;
    this.askedSpeed = -1e9;
    this.link = addressed(); // start time from the address, s
    this.linked = -1e9;
    this.scrub = element("scrub");
    this.speed = element("speed");
    for (const speed of SPEEDS) {
      const option = document.createElement("option");
      option.value = String(speed);
      option.textContent = `${speed} ×`;
      this.speed.append(option);
    }
    this.speed.value = "1";
    this.scrub.addEventListener("input", () => this.seek(Number(this.scrub.value)));
    this.speed.addEventListener("change", () => this.go(Number(this.speed.value)));
    element("play").addEventListener("click", () => this.toggle());
    element("first").addEventListener("click", () => this.seek(0));
    element("last").addEventListener("click", () => this.seek(this.last));
    element("back").addEventListener("click", () => this.seek(this.step - 1));
    element("on").addEventListener("click", () => this.seek(this.step + 1));
    document.addEventListener("keydown", (event) => this.key(event));
    window.addEventListener("hashchange", () => {
      this.link = addressed();
      this.follow();
    });
  }

  hello(hello) {
    this.enabled = hello.playback;
    this.last = hello.last_step ?? 0;
    this.period = hello.period;
    this.scrub.max = String(this.last);
    element("playback").hidden = !hello.playback;
  }

  // Go to the time in the address, once.
  follow() {
    if (this.link !== null && this.enabled && !this.lost && this.period) {
      this.seekTime(this.link);
      this.link = null;
    }
  }

  // Disable playback without a connection.
  connected(connected) {
    this.lost = !connected;
    element("playback").disabled = this.lost;
  }

  // Continue where the page was before it lost the connection.
  resume({ step, playing, speed }) {
    this.send({ type: "speed", speed });
    this.seek(step);
    if (playing) {
      this.send({ type: "play" });
    }
  }

  state(message) {
    if (message.playing === null) {
      return;
    }
    this.playing = message.playing;
    const button = element("play");
    button.textContent = message.playing ? "‖ Pause" : "▶ Play";
    button.setAttribute("aria-label", message.playing ? "Pause" : "Play");
    const asked = performance.now() - this.askedSpeed < PATIENCE;
    if (document.activeElement !== this.speed && message.speed !== null && !asked) {
      this.speed.value = String(message.speed);
    }
  }

  // Ignore a frame that was sent before the requested step: the next key must count from the requested one.
  frame(frame) {
    const since = performance.now() - this.asked;
    if (frame.step !== this.step && since < (this.playing ? HOLD : PATIENCE)) {
      return;
    }
    this.step = frame.step;
    this.scrub.value = String(frame.step);
    element("clock").textContent = `${frame.time.toFixed(2)} of ${(this.last * (this.period ?? 0)).toFixed(2)} s`;
    this.address(frame.time);
    this.scrub.setAttribute("aria-valuetext", `step ${frame.step}, ${frame.time.toFixed(2)} seconds`);
  }

  // Keep the time in the address, at a limited rate: browsers throttle frequent changes.
  address(time) {
    const wanted = `#t=${Number(time.toFixed(6))}`;
    const wait = this.linked + ADDRESS - performance.now();
    clearTimeout(this.pending);
    if (!this.enabled || this.link !== null || location.hash === wanted || (time === 0 && !location.hash)) {
      return;
    }
    this.pending = setTimeout(() => {
      this.linked = performance.now();
      history.replaceState(null, "", wanted);
    }, Math.max(wait, 0));
  }

  toggle() {
    this.send({ type: this.playing ? "pause" : "play" });
  }

  seek(step) {
    this.step = Math.min(Math.max(Math.round(step), 0), this.last);
    this.asked = performance.now();
    this.scrub.value = String(this.step);
    this.send({ type: "seek", step: this.step });
  }

  seekTime(time) {
    if (this.enabled && !this.lost && this.period) {
      this.seek(time / this.period);
    }
  }

  faster(direction) {
    const next = Math.min(Math.max(this.speed.selectedIndex + direction, 0), SPEEDS.length - 1);
    this.speed.selectedIndex = next;
    this.go(SPEEDS[next]);
  }

  go(speed) {
    this.askedSpeed = performance.now();
    this.send({ type: "speed", speed });
  }

  key(event) {
    const target = event.target;
    const typed = target instanceof HTMLInputElement && target !== this.scrub;
    const ownKeys = typed || target instanceof HTMLSelectElement || scrolls(target, event.key);
    const pressed = target instanceof HTMLButtonElement && event.key === " ";
    const opened = target instanceof HTMLElement && target.tagName === "SUMMARY" && event.key === " ";
    if (!this.enabled || this.lost || ownKeys || pressed || opened || event.ctrlKey || event.altKey || event.metaKey) {
      return;
    }
    const stride = event.shiftKey && this.period ? Math.round(1 / this.period) : 1;
    const action = {
      " ": () => this.toggle(),
      ArrowLeft: () => this.seek(this.step - stride),
      ArrowRight: () => this.seek(this.step + stride),
      Home: () => this.seek(0),
      End: () => this.seek(this.last),
      "+": () => this.faster(1),
      "-": () => this.faster(-1),
    }[event.key];
    if (action) {
      event.preventDefault();
      action();
    }
  }
}
