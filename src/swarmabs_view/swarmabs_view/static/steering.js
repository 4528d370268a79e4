// Steering of a run that goes on, for those who know its token. Asks, shows the answer, and what holds now.
import { parsed, short } from "./drawing.js";

const STORE = "swarmabs-steer";
const LONGEST = 100; // characters of a token that the server takes
const LARGE = 0.2; // part of the largest value by which a change is asked back
const WRONG = "The token is wrong. It stands in the terminal of the run; load the page again to enter it.";
const SETTINGS = { reference: "rad", disturbance: "N m" };

const element = (id) => document.getElementById(id);

// The token in what somebody has pasted: it alone, or the address that ends with it.
function pasted(text) {
  const [, given] = text.match(/#(.*)/s) ?? [];
  return (given === undefined ? text : new URLSearchParams(given).get("steer") ?? "").trim();
}

const possible = (given) => given !== "" && given.length <= LONGEST;

// The token comes behind the # of the address, which browsers send to nobody, and stays in this tab alone.
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

function options(select, robots) {
  const known = [...select.options].map((option) => Number(option.value));
  if (known.length === robots.length && robots.every((robot, index) => robot === known[index])) {
    return;
  }
  const chosen = select.value;
  select.replaceChildren(...robots.map((robot) => new Option(`robot ${robot}`, String(robot))));
  if (robots.includes(Number(chosen))) {
    select.value = chosen;
  }
}

export class Steering {
  constructor(send) {
    this.send = send;
    this.token = token();
    this.asked = new Map();
    this.first = element("steered").textContent;
    this.limits = {};
    this.wrong = false;
    for (const name of Object.keys(SETTINGS)) {
      element(`steer-${name}`).addEventListener("submit", (event) => {
        event.preventDefault();
        this.set(name, element(`steer-${name}-value`).value);
      });
    }
    element("steer-sure").addEventListener("submit", (event) => {
      event.preventDefault();
      const { name, value } = this.unsure;
      this.ask({ action: name, value }, `${name} ${value}`);
      this.sure(null);
    });
    element("sure-no").addEventListener("click", () => this.sure(null));
    window.addEventListener("hashchange", () => this.arrived());
    for (const name of ["member", "absent"]) {
      element(`steer-${name}`).addEventListener("submit", (event) => {
        event.preventDefault();
        const { value: action, textContent: words } = event.submitter;
        const agent = Number(element(name).value);
        this.ask({ action, agent }, `${words.toLowerCase()} robot ${agent}`);
      });
    }
    element("steer-token").addEventListener("submit", (event) => {
      event.preventDefault();
      this.use(pasted(element("token").value));
      element("token").value = "";
    });
    this.show();
  }

  // A token in an address that is opened where this page is shown already.
  arrived() {
    const given = token();
    if (given && given !== this.token) {
      this.use(given);
      this.check();
    }
  }

  // Set what was typed, if it is a number in its range; ask back before a large change.
  set(name, text) {
    const value = parsed(text);
    const { largest, held } = this.limits[name];
    const unit = SETTINGS[name];
    let why = "";
    if (value === null) {
      why = `"${text}" is no number: write 0.05 or 0,05`;
    } else if (Math.abs(value) > largest) {
      why = `${short(value)} ${unit} is out of range`;
    }
    element(`wrong-${name}`).textContent = why;
    element(`steer-${name}-value`).setAttribute("aria-invalid", String(why !== ""));
    if (why) {
      this.sure(null);
    } else if (Math.abs(value - held) > LARGE * largest) {
      this.sure({ name, value }, `A large step: set the ${name} from ${short(held)} to ${short(value)} ${unit}?`);
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
    if (unsure) {
      element("sure-yes").focus();
    }
  }

  // Have the server say whether the token is right before anything is shown that needs it.
  check() {
    if (this.token) {
      this.send({ type: "unlock", token: this.token });
    }
  }

  use(given) {
    if (!possible(given)) {
      this.say(`this is no token: ${given ? `it has more than ${LONGEST} characters` : "there is none in it"}`);
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

  ask(wish, words) {
    const bytes = crypto.getRandomValues(new Uint8Array(12));
    const request = [...bytes].map((byte) => byte.toString(16).padStart(2, "0")).join("");
    if (this.send({ type: "steer", token: this.token, request, ...wish })) {
      this.asked.set(request, words);
      this.say(`${words}: asked`);
    } else {
      this.say(`${words}: not sent: no connection`);
    }
  }

  // No answers come over a connection that is gone; one that the server has ended because of a request took no token.
  connected(connected, refused) {
    element("steer-controls").disabled = !connected;
    if (connected || !this.asked.size) {
      return;
    }
    const words = [...this.asked.values()].join(", ");
    this.asked.clear();
    if (refused) {
      this.say(`${words}: not done: the program has refused the request`);
      this.forget();
    } else {
      this.say(`${words}: no answer: the connection was lost; the events say whether it was done`);
    }
  }

  say(text) {
    element("steered").textContent = text;
  }

  show() {
    element("steer-token").hidden = this.token !== "" || this.wrong;
    element("steer-controls").hidden = this.token === "";
  }

  // What is shown now cannot be steered, unless the server says so again.
  hello() {
    element("steering").hidden = true;
    this.check();
  }

  take(message) {
    element("steering").hidden = !message.open;
    for (const [name, unit] of Object.entries(SETTINGS)) {
      const largest = message[`largest_${name}`];
      this.limits[name] = { largest, held: message[name] };
      element(`range-${name}`).textContent = `${short(-largest, 3)} to ${short(largest, 3)} ${unit}`;
      element(`steer-${name}`).hidden = !largest;
      const held = element(`held-${name}`);
      held.value = String(message[name]);
      held.textContent = `${short(message[name])} ${unit}`;
    }
    options(element("member"), message.members);
    options(element("absent"), message.absent);
    element("steer-absent").hidden = !message.absent.length;
  }

  answer(message) {
    if (!message.known) {
      this.asked.clear();
      this.wrong = true;
      this.forget();
      this.say(WRONG);
      return;
    }
    const words = this.asked.get(message.request) ?? "request";
    this.asked.delete(message.request);
    this.say(`${words}: ${message.ok ? "" : "not done: "}${message.text}`);
  }
}
