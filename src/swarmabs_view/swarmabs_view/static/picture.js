// The picture of the parent system with its robots: what all scenes have in common.
import { prepared } from "./drawing.js";
import { PlaneScene } from "./plane.js";
import { SystemScene } from "./system.js";

const CROWD = 60; // above this number of robots, a scene may show their density
const NEAR = 5; // px around a robot within which the pointer selects it

export class Picture {
  constructor(canvas) {
    this.canvas = canvas;
    this.label = document.getElementById("pointed");
    this.pointer = null;
    this.spots = []; // places of what is drawn, each with its text
    this.ids = new Map(); // where the ids of the robots are
    this.described = -Infinity; // when, ms
    this.fit = false; // whether the scale follows the swarm, not the parent system
    this.own = { plane: new PlaneScene() }; // scenes of parent systems with a picture of their own
    this.usual = new SystemScene();
    for (const kind of ["pointermove", "pointerdown"]) {
      canvas.addEventListener(kind, (event) => this.point({ x: event.offsetX, y: event.offsetY }));
    }
    canvas.addEventListener("pointerleave", () => this.point(null));
  }

  scene({ system }) {
    return Object.hasOwn(this.own, system.name) ? this.own[system.name] : this.usual;
  }

  hello(hello) {
    this.scene(hello).hello();
    this.described = -Infinity;
  }

  crowded(hello) {
    return this.scene(hello).crowds && hello.robots.length > CROWD;
  }

  draw(hello, frame) {
    const view = { fit: this.fit, crowded: this.crowded(hello), ids: this.ids };
    this.spots = this.scene(hello).draw(prepared(this.canvas), hello, frame, view);
    this.tell();
    this.describe(hello, frame);
  }

  point(pointer) {
    this.pointer = pointer;
    this.tell();
  }

  // Label the robot under the pointer, even one that is too small for its number.
  tell() {
    const { pointer, label, canvas } = this;
    const far = (spot) => Math.hypot(spot.x - pointer.x, spot.y - pointer.y); // from the middle
    const near = pointer ? this.spots.filter((spot) => far(spot) <= spot.size + NEAR) : [];
    const nearest = near.reduce((best, spot) => (best && far(best) <= far(spot) ? best : spot), null);
    label.hidden = !nearest;
    if (label.hidden) {
      return;
    }
    label.textContent = nearest.text;
    const most = canvas.clientWidth - label.offsetWidth;
    const x = canvas.offsetLeft + Math.min(Math.max(nearest.x - label.offsetWidth / 2, 0), most);
    const y = canvas.offsetTop + nearest.y - nearest.size - label.offsetHeight - 6;
    label.style.transform = `translate(${x}px, ${y}px)`;
  }

  // Describe the canvas for screen readers, at most once a second.
  describe(hello, frame) {
    const now = performance.now();
    if (now - this.described < 1000) {
      return;
    }
    this.described = now;
    const said = this.scene(hello).describe(hello, frame);
    this.canvas.setAttribute("aria-label", `${said}; ${hello.robots.length} robots, listed in the table of robots`);
  }
}
