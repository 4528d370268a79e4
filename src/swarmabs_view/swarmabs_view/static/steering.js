// Steers a running simulation for users who know its token: sends requests, shows the answers and current settings.
import { united } from "./description.js";
import { parsed, short } from "./drawing.js";

const STORE = "swarmabs-steer";
const LONGEST = 100; // characters; longer tokens are rejected by the server
const LARGE = 0.2; // fraction of the largest value above which a change needs a confirmation
const ANY = 1e9; // a larger bound is none
const WRONG = "The token is wrong. The terminal of the run shows it; reload the page to enter it.";
const SETTINGS = { reference: "rad", disturbance: "N m" }; // with their units on the plane

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

export class SteeringPanel {
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

  // Set the typed value if it is a number in range; a large change needs a confirmation.
  set(name, text) {
    const value = parsed(text);
    const { largest, held } = this.limits[name];
    const unit = this.units[name];
    let why = "";
    if (value === null) {
      why = `"${text}" is not a number: write 0.05 or 0,05`;
    } else if (Math.abs(value) > largest) {
      why = `${short(value)} ${unit} is out of range`;
    }
    element(`wrong-${name}`).textContent = why;
    element(`steer-${name}-value`).setAttribute("aria-invalid", String(why !== ""));
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
    element("steer-controls").disabled = !connected;
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

  say(text) {
    element("steered").textContent = text;
  }

  show() {
    element("steer-token").hidden = this.token !== "" || this.wrong;
    element("steer-controls").hidden = this.token === "";
  }

  // Hide the panel until the server says that the run can be steered.
  hello() {
    element("steering").hidden = true;
    this.check();
  }

  // Name the settings of a parent system; the unit of its disturbances is not known.
  describe(system) {
    const unit = system?.rows.find(({ role }) => role === "reference")?.unit ?? "";
    this.units = system ? { reference: unit, disturbance: "" } : SETTINGS;
    element("steer-reference").querySelector("label").textContent = united("Reference offset", this.units.reference);
    element("steer-disturbance").querySelector("label").textContent = system ? "Disturbance" : "Disturbance torque, N m";
  }

  take(message) {
    element("steering").hidden = !message.open;
    for (const [name, unit] of Object.entries(this.units)) {
      const largest = message[`largest_${name}`];
      this.limits[name] = { largest, held: message[name] };
      element(`range-${name}`).textContent = largest < ANY ? `${short(-largest, 3)} to ${short(largest, 3)} ${unit}` : "any number";
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
    const label = this.asked.get(message.request) ?? "request";
    this.asked.delete(message.request);
    this.say(`${label}: ${message.ok ? "" : "rejected: "}${message.text}`);
  }
}
