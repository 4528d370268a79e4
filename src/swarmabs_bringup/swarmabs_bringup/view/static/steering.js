// Steering of a run that goes on, for those who know its token. Asks, shows the answer, and what holds now.
import { short } from "./drawing.js";

const STORE = "swarmabs-steer";

const element = (id) => document.getElementById(id);

// The token comes behind the # of the address, which browsers send to nobody, and stays in this tab alone.
function token() {
  const given = new URLSearchParams(location.hash.slice(1)).get("steer");
  if (given) {
    sessionStorage.setItem(STORE, given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem(STORE) ?? "";
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
      this.token = element("token").value;
      element("token").value = "";
      sessionStorage.setItem(STORE, this.token);
      this.show();
    });
    this.show();
  }

  ask(wish, words) {
    const bytes = crypto.getRandomValues(new Uint8Array(12));
    const request = [...bytes].map((byte) => byte.toString(16).padStart(2, "0")).join("");
    this.asked.set(request, words);
    this.say(`${words}: asked`);
    this.send({ type: "steer", token: this.token, request, ...wish });
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
      this.token = "";
      sessionStorage.removeItem(STORE);
      this.show();
    }
  }
}
