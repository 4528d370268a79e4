// Steers a running simulation for users who know its token: sends requests, shows the answers and current settings.
import { united } from "./description.js";
import { parsed, short } from "./drawing.js";
import { Push } from "./push.js";
import { STATUS } from "./tables.js";

const STORE = "swarmabs-steer";
const LONGEST = 100; // characters; longer tokens are rejected by the server
const LARGE = 0.2; // fraction of the largest value above which a change needs a confirmation
const ANY = 1e9; // a larger bound is none
const WRONG = "The token is wrong. The terminal of the run shows it; reload the page to enter it.";
const STARTED = "The next run has begun.";
const WAITS = "The next run waits at its first step: resume it.";
const SETTINGS = ["reference", "disturbance"];
const FULL = 0.8; // fraction of the largest disturbance that is a full push until another strength is typed
const NEXT = 60_000; // ms after which the next run does not come any more
const LONG = 24; // characters of a wrong number that are repeated

const element = (id) => document.getElementById(id);

// The token in pasted text: either the token alone, or an address that ends with it.
function pasted(text) {
  const [, given] = text.match(/#(.*)/s) ?? [];
  return (given === undefined ? text : new URLSearchParams(given).get("steer") ?? "").trim();
}

const possible = (given) => given !== "" && given.length <= LONGEST;

// The token follows the # of the address, a part that browsers never send, and is stored for this tab only.
function token() {
  const given = pasted(location.hash);
  if (given) {
    history.replaceState(null, "", location.pathname);
  }
  if (possible(given)) {
    sessionStorage.setItem(STORE, given);
  }
  const kept = sessionStorage.getItem(STORE) ?? "";
  return possible(kept) ? kept : "";
}

// List robots; one that cannot be chosen keeps its place, and `word` tells why.
function options(select, robots, possible, word) {
  const known = [...select.options].map((option) => Number(option.value));
  if (known.length !== robots.length || robots.some((robot, index) => robot !== known[index])) {
    const chosen = select.value;
    select.replaceChildren(...robots.map((robot) => new Option(`robot ${robot}`, String(robot))));
    select.value = robots.includes(Number(chosen)) ? chosen : String(possible[0] ?? "");
  }
  for (const option of select.options) {
    const robot = Number(option.value);
    option.disabled = !possible.includes(robot);
    const text = option.disabled ? `robot ${robot}: ${word(robot)}` : `robot ${robot}`;
    if (option.text !== text) {
      option.text = text;
    }
  }
}

export class SteeringPanel {
  // `status` returns the status of a robot in the frame that is shown.
  constructor(send, status) {
    this.send = send;
    this.status = status;
    this.robots = [];
    this.joining = [];
    this.message = { open: false };
    this.restarting = false; // whether the next run is about to take the place of this one
    this.online = false;
    this.token = token();
    this.asked = new Map();
    this.first = element("steered").textContent;
    this.limits = {};
    this.wrong = false;
    for (const name of SETTINGS) {
      element(`steer-${name}`).addEventListener("submit", (event) => {
        event.preventDefault();
        this.set(name, element(`steer-${name}-value`).value);
      });
    }
    element("steer-sure").addEventListener("submit", (event) => {
      event.preventDefault();
      const { name, value } = this.unsure;
      this.sure(null);
      this.ask({ action: name, value }, `${name} ${value}`);
    });
    element("steer-push").addEventListener("submit", (event) => {
      event.preventDefault();
      const strength = this.strength();
      if (strength !== null) {
        this.push(Number(event.submitter.value) * strength);
      }
    });
    element("steer-push-value").addEventListener("input", () => this.strength());
    element("pause").addEventListener("click", () => this.pause());
    document.addEventListener("keydown", (event) => {
      const taken = event.target.closest?.("input, select, button, summary") || event.ctrlKey || event.altKey || event.metaKey;
      if (event.key === " " && !taken && this.ready()) {
        event.preventDefault();
        this.pause();
      }
    });
    for (const button of document.querySelectorAll("#steering .restart")) {
      button.addEventListener("click", () => this.ask({ action: button.value }, button.textContent));
    }
    new Push(element("plane"), () => this.full(), (push) => this.push(push));
    element("sure-no").addEventListener("click", () => this.sure(null));
    window.addEventListener("hashchange", () => this.arrived());
    for (const name of ["member", "absent"]) {
      element(`steer-${name}`).addEventListener("submit", (event) => {
        event.preventDefault();
        const { value: action, textContent: label } = event.submitter;
        const agent = Number(element(name).value);
        this.ask({ action, agent }, `${label.toLowerCase()} robot ${agent}`);
      });
    }
    element("steer-token").addEventListener("submit", (event) => {
      event.preventDefault();
      this.use(pasted(element("token").value));
      element("token").value = "";
    });
    this.show();
  }

  // Use the token of an address that is opened in the tab of this page.
  arrived() {
    const given = token();
    if (given && given !== this.token) {
      this.use(given);
      this.check();
    }
  }

  // Whether requests can be sent now.
  ready() {
    return this.online && this.message.open && this.token !== "";
  }

  pause() {
    const action = this.message.paused ? "resume" : "pause";
    this.ask({ action }, action);
  }

  push(value) {
    this.sure(null);
    this.ask({ action: "push", value }, `push ${short(value, 2)}`);
  }

  // The strength of a full push for drags on the picture; on the plane it has a lever.
  full() {
    const strength = this.ready() && this.message.largest_disturbance ? this.strength() ?? 0 : 0;
    return { strength, unit: this.units.disturbance, lever: this.lever };
  }

  // The typed strength of a push, null if it is none.
  strength() {
    const text = element("steer-push-value").value;
    const value = parsed(text);
    const { largest } = this.limits.disturbance;
    let why = "";
    if (value === null || value <= 0) {
      why = `"${text.slice(0, LONG)}" is not a positive number`;
    } else if (value > largest) {
      why = `${short(value, 3)} ${this.units.disturbance} is more than ${short(largest, 3)}`;
    }
    this.mark("push", why);
    return why ? null : value;
  }

  mark(name, why) {
    element(`wrong-${name}`).textContent = why;
    element(`steer-${name}-value`).setAttribute("aria-invalid", String(why !== ""));
  }

  // Set the typed value if it is a number in range; a large change needs a confirmation.
  set(name, text) {
    const value = parsed(text);
    const { largest, held } = this.limits[name];
    const unit = this.units[name];
    let why = "";
    if (value === null) {
      why = `"${text.slice(0, LONG)}" is not a number: write 0.05 or 0,05`;
    } else if (Math.abs(value) > largest) {
      why = `${short(value)} ${unit} is out of range`;
    }
    this.mark(name, why);
    if (why) {
      this.sure(null);
    } else if (Math.abs(value - held) > LARGE * largest) {
      this.sure({ name, value }, `Large step: set the ${name} from ${short(held)} to ${short(value)} ${unit}?`);
    } else {
      this.sure(null);
      this.ask({ action: name, value }, `${name} ${value}`);
    }
  }

  sure(unsure, text = "") {
    if (!unsure && this.unsure) {
      element(`steer-${this.unsure.name}-value`).focus();
    }
    this.unsure = unsure;
    element("sure-text").textContent = text;
    element("steer-sure").hidden = !unsure;
    element("steered").hidden = Boolean(unsure);
    if (unsure) {
      element("sure-yes").focus();
    }
  }

  // Let the server check the token before the page shows controls that need it.
  check() {
    if (this.token) {
      this.send({ type: "unlock", token: this.token });
    }
  }

  use(given) {
    if (!possible(given)) {
      this.say(`not a token: ${given ? `it has more than ${LONGEST} characters` : "the text contains none"}`);
      return;
    }
    this.token = given;
    this.wrong = false;
    sessionStorage.setItem(STORE, given);
    this.say(this.first);
    this.show();
    this.check();
  }

  forget() {
    this.token = "";
    this.sure(null);
    sessionStorage.removeItem(STORE);
    this.show();
  }

  ask(request, label) {
    const bytes = crypto.getRandomValues(new Uint8Array(12));
    const id = [...bytes].map((byte) => byte.toString(16).padStart(2, "0")).join("");
    if (this.send({ type: "steer", token: this.token, request: id, ...request })) {
      this.asked.set(id, label);
      this.say(`${label}: requested`);
    } else {
      this.say(`${label}: not sent: no connection`);
    }
  }

  // A lost connection delivers no answers; if the server closed it because of a request, it did not accept the token.
  connected(connected, refused) {
    this.online = connected;
    this.enable();
    if (connected || !this.asked.size) {
      return;
    }
    const labels = [...this.asked.values()].join(", ");
    this.asked.clear();
    if (refused) {
      this.say(`${labels}: rejected by the program`);
      this.forget();
    } else {
      this.say(`${labels}: no answer: connection lost; the events show whether it was applied`);
    }
  }

  enable() {
    element("steer-controls").disabled = !this.online || !this.message.open;
    element("plane").classList.toggle("pushable", this.ready() && this.message.largest_disturbance > 0);
  }

  say(text) {
    element("steered").textContent = text;
  }

  show() {
    element("steer-token").hidden = this.token !== "" || this.wrong;
    element("steer-controls").hidden = this.token === "";
    this.enable();
  }

  // Hide the panel until the server says that the run can be steered, unless the next run takes the place of this one.
  hello({ robots }) {
    this.robots = robots.map(({ id }) => id);
    this.joining = [];
    element("steering").hidden = !this.restarting;
    this.check();
  }

  // Name the settings of a parent system; `lever` says whether a push acts by the distance from an axis.
  describe(system, lever) {
    const unit = system.rows.find(({ role }) => role === "reference")?.unit ?? "";
    this.units = { reference: unit, disturbance: system.disturbance_unit };
    this.lever = lever;
    element("label-reference").textContent = united("Reference offset", this.units.reference);
    element("label-disturbance").textContent = united("Disturbance", this.units.disturbance);
    element("label-push").textContent = united("Push", this.units.disturbance);
  }

  take(message) {
    if (message.open && this.restarting) {
      this.restarting = false;
      this.say(message.paused ? WAITS : STARTED);
    }
    element("steering").hidden = !message.open && !this.restarting;
    this.message = message;
    this.enable();
    if (!message.open) {
      return;
    }
    element("pause").textContent = message.paused ? "Resume" : "Pause";
    for (const button of document.querySelectorAll("#steering .restart")) {
      button.hidden = !message.restarts;
    }
    for (const [name, unit] of Object.entries(this.units)) {
      const largest = message[`largest_${name}`];
      this.limits[name] = { largest, held: message[name] };
      element(`range-${name}`).textContent = largest < ANY ? `${short(-largest, 3)} to ${short(largest, 3)} ${unit}` : "any number";
      element(`steer-${name}`).hidden = !largest;
      const held = element(`held-${name}`);
      held.value = String(message[name]);
      held.textContent = `${short(message[name])} ${unit}`;
    }
    const largest = message.largest_disturbance;
    const value = element("steer-push-value");
    element("steer-push").hidden = !largest;
    value.value ||= short(largest < ANY ? FULL * largest : 1, 2);
    element("range-push").textContent = largest < ANY ? `at most ${short(largest, 3)} ${this.units.disturbance}` : "any strength";
    this.joining = this.robots.filter((robot) => this.joining.includes(robot) || message.absent.includes(robot));
    const others = this.robots.filter((robot) => !message.absent.includes(robot));
    const word = (robot) => STATUS[this.status(robot)] ?? "not there";
    options(element("member"), others, message.members, word);
    options(element("absent"), this.joining, message.absent, word);
    element("steer-absent").hidden = !this.joining.length;
  }

  answer(message) {
    if (!message.known) {
      this.asked.clear();
      this.wrong = true;
      this.forget();
      this.say(WRONG);
      return;
    }
    const label = this.asked.get(message.request) ?? "request";
    if (message.ok && message.restarts) {
      this.restarting = true;
      clearTimeout(this.patience);
      this.patience = setTimeout(() => { this.restarting = false; }, NEXT);
    }
    this.asked.delete(message.request);
    this.say(`${label}: ${message.ok ? "" : "rejected: "}${message.text}`);
  }
}
