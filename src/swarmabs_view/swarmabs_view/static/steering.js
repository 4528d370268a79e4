// Steering of a run that goes on, for those who know its token. Asks, shows the answer, and what holds now.
import { short } from "./drawing.js";

const STORE = "swarmabs-steer";
const LONGEST = 100; // characters of a token that the server takes

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
    for (const name of ["reference", "disturbance"]) {
      element(`steer-${name}`).addEventListener("submit", (event) => {
        event.preventDefault();
        const value = element(`steer-${name}-value`).valueAsNumber;
        this.ask({ action: name, value }, `${name} ${value}`);
      });
    }
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

  use(given) {
    if (!possible(given)) {
      this.say(`this is no token: ${given ? `it has more than ${LONGEST} characters` : "there is none in it"}`);
      return;
    }
    this.token = given;
    sessionStorage.setItem(STORE, given);
    this.say(this.first);
    this.show();
  }

  forget() {
    this.token = "";
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
    element("steer-token").hidden = this.token !== "";
    element("steer-controls").hidden = this.token === "";
  }

  // What is shown now cannot be steered, unless the server says so again.
  hello() {
    element("steering").hidden = true;
  }

  take(message) {
    element("steering").hidden = !message.open;
    for (const [name, unit] of [["reference", "rad"], ["disturbance", "N m"]]) {
      const value = element(`steer-${name}-value`);
      const largest = message[`largest_${name}`];
      value.min = String(-largest);
      value.max = String(largest);
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
    const words = this.asked.get(message.request) ?? "request";
    this.asked.delete(message.request);
    this.say(`${words}: ${message.ok ? "" : "not done: "}${message.text}`);
    if (!message.known) {
      this.forget();
    }
  }
}
