// Pushes the parent system by dragging on its picture, with mouse, pen or finger.
import { short } from "./drawing.js";
import { PIVOT, SIDE } from "./plane.js";

const REACH = 0.3; // fraction of the picture's height or width over which a drag is a full push
const LEAST = 0.02; // fraction of a full push below which a drag is none
const HEAD = 14; // px, length of the arrow's head

// The fraction of a full push, -1 to 1. On the plane the drag is a force, whose lever is the distance from the axis: a
// positive push turns the right side down. In other pictures a positive push points to the right.
export function fraction(from, to, { width, height }, lever) {
  const [dx, dy] = [to.x - from.x, to.y - from.y];
  const [x, y] = [from.x - 0.5 * width, from.y - PIVOT * height];
  const push = lever ? (x * dy - y * dx) / (SIDE * width * REACH * height) : dx / (REACH * width);
  return Math.min(Math.max(push, -1), 1);
}

export class Push {
  // `full` returns the strength of a full push, 0 if there is none, with its unit and whether it has a lever; `pushed`
  // receives the strength.
  constructor(canvas, full, pushed) {
    this.canvas = canvas;
    this.full = full;
    this.from = null;
    this.arrow = document.getElementById("push");
    this.label = document.getElementById("pushed");
    canvas.addEventListener("pointerdown", (event) => this.begin(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => {
      const push = this.strength(event);
      this.end();
      if (push) {
        pushed(push);
      }
    });
    for (const kind of ["pointercancel", "lostpointercapture"]) {
      canvas.addEventListener(kind, () => this.end());
    }
    document.addEventListener("keydown", (event) => event.key === "Escape" && this.end());
  }

  begin(event) {
    if (event.isPrimary && event.button === 0 && this.full().strength) {
      this.canvas.setPointerCapture(event.pointerId);
      this.from = { x: event.offsetX, y: event.offsetY };
    }
  }

  // The strength of the drag so far, 0 if there is no drag or if it is too short to be meant.
  strength(event) {
    const { strength, lever } = this.full();
    const size = { width: this.canvas.clientWidth, height: this.canvas.clientHeight };
    const part = this.from ? fraction(this.from, { x: event.offsetX, y: event.offsetY }, size, lever) : 0;
    return Math.abs(part) < LEAST ? 0 : Number((part * strength).toPrecision(2));
  }

  move(event) {
    if (!this.from) {
      return;
    }
    const push = this.strength(event);
    const { strength, unit, lever } = this.full();
    const side = push > 0 ? "right" : "left";
    const where = lever ? `${side} side down` : `to the ${side}`;
    const size = [short(Math.abs(push), 2), unit].filter(Boolean).join(" ");
    this.label.textContent = push ? `Push ${size}, ${where}` : "No push";
    this.draw({ x: event.offsetX, y: event.offsetY }, Math.abs(push) / strength);
  }

  draw(to, part) {
    const { canvas, arrow, label, from } = this;
    const [dx, dy] = [to.x - from.x, to.y - from.y];
    const far = Math.hypot(dx, dy) || 1;
    const [ux, uy] = [dx / far, dy / far];
    const head = Math.min(HEAD, far);
    const [bx, by] = [to.x - head * ux, to.y - head * uy];
    const wide = 0.6 * head;
    const [line, tip] = arrow.children;
    const ends = { x1: from.x, y1: from.y, x2: bx, y2: by, "stroke-width": 2 + 6 * part };
    Object.entries(ends).forEach(([name, value]) => line.setAttribute(name, value));
    tip.setAttribute("d", `M${to.x} ${to.y}L${bx - wide * uy} ${by + wide * ux}L${bx + wide * uy} ${by - wide * ux}Z`);
    const corner = `translate(${canvas.offsetLeft}px, ${canvas.offsetTop}px)`;
    Object.assign(arrow.style, { left: "0", top: "0", transform: corner });
    this.shown(true);
    const x = Math.min(Math.max(to.x - label.offsetWidth / 2, 0), canvas.clientWidth - label.offsetWidth);
    const y = Math.min(Math.max(to.y + 14, 0), canvas.clientHeight - label.offsetHeight);
    label.style.transform = `translate(${canvas.offsetLeft + x}px, ${canvas.offsetTop + y}px)`;
  }

  end() {
    this.from = null;
    this.shown(false);
  }

  shown(shown) {
    this.arrow.toggleAttribute("hidden", !shown);
    this.label.hidden = !shown;
  }
}
