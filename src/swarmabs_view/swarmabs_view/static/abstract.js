// Two rows of the abstract state; with the manifold and the sets A_A and A_P, where these are known.
import { rowsOf } from "./description.js";
import { axes, framed, mapping, marked, prepared, short } from "./drawing.js";

const TRAIL = 400;
const ROOM = 120; // px, height of the axes from which on there is an inset, with texts of the usual size

export class AbstractView {
  // `changed` is called when the user has chosen a row.
  constructor(canvas, changed) {
    this.canvas = canvas;
    this.near = true;
    this.left = 0;
    this.choices = ["row-x", "row-y"].map((id) => document.getElementById(id));
    this.choices.forEach((choice) => {
      choice.addEventListener("change", () => {
        this.rows = this.choices.map((one) => this.all[one.value]);
        [this.left, this.described] = [0, -Infinity];
        changed();
      });
    });
  }

  hello({ system }) {
    if (system.name === this.system?.name) {
      return;
    }
    this.system = system;
    this.all = rowsOf(system);
    this.rows = this.all.slice(0, 2);
    [this.left, this.described] = [0, -Infinity];
    this.choices.forEach((choice, axis) => {
      choice.replaceChildren(...this.all.map((one, index) => new Option(one.name, index, false, index === axis)));
      choice.parentElement.hidden = this.all.length < 3;
    });
    this.canvas.parentElement.hidden = this.all.length < 2;
  }

  bounds(hello, frame, trail, near) {
    const points = [...trail, ...this.points(frame).filter(Boolean)];
    let [left, right] = [Infinity, -Infinity];
    let [low, high] = [Infinity, -Infinity];
    for (const [x, y] of points) {
      left = Math.min(left, x);
      right = Math.max(right, x);
      low = Math.min(low, y);
      high = Math.max(high, y);
    }
    const manifold = hello.manifold;
    if ((near || !manifold) && points.length) {
      const [dx, dy] = [Math.max(0.1 * (right - left), this.rows[0].margin), Math.max(0.1 * (high - low), this.rows[1].margin)];
      return [left - dx, right + dx, Math.max(this.rows[1].least, low - dy), high + dy];
    }
    if (manifold) {
      const end = 1.1 * manifold.torque_max;
      [left, right] = [Math.min(left, -end), Math.max(right, end)];
      high = Math.max(high, 1.05 * (manifold.curvature * end * end + manifold.offset));
    }
    if (!(right > left)) {
      [left, right] = [-1, 1];
    }
    return [left, right, 0, high > 0 ? 1.05 * high : 1];
  }

  // The actual and the wanted point of a frame, each null if unknown.
  points(frame) {
    const found = ["actual", "wanted"].map((which) => this.rows.map((one) => one[which](frame) ?? null));
    return found.map((point) => (point.includes(null) ? null : point));
  }

  draw(hello, frame, curves) {
    if (this.rows.length < 2) {
      return;
    }
    const surface = prepared(this.canvas);
    const { context, colour, height, unit } = surface;
    const trail = this.trail(curves, frame.time);
    const shown = this.bounds(hello, frame, trail, this.near);
    const marks = marked(shown[2], shown[3], height, unit);
    const box = framed(surface, marks, this.left);
    this.left = box.left;
    const at = mapping(box, shown);
    this.contents(surface, hello, this.points(frame), trail, box, at, shown);
    axes(surface, at, box, shown, marks, this.rows.map((one) => one.title));
    if (this.near && hello.manifold && trail.length && box.h >= ROOM * unit) {
      this.inset(surface, hello, frame, trail, box, shown, at);
    }
    this.describe(hello, frame);
  }

  contents({ context, colour, unit }, hello, points, trail, { x, y, w, h }, at, shown) {
    context.save();
    context.beginPath();
    context.rect(x, y, w, h);
    context.clip();
    if (hello.regions) {
      this.region(context, hello.regions, "admissible", "reachable", colour.partial, at);
      this.region(context, hello.regions, "smallest", "admissible", colour.admissible, at);
    }
    if (hello.manifold) {
      this.manifold(context, hello.manifold, colour, at, this.torques(hello.manifold, shown));
    }
    context.strokeStyle = colour.angle;
    context.lineWidth = 1.5 * unit;
    context.lineJoin = "round";
    context.beginPath();
    trail.forEach((point) => context.lineTo(...at(...point)));
    context.stroke();
    context.lineJoin = "miter";
    this.marks(context, points, colour, at, unit);
    context.restore();
  }

  // An inset of the whole manifold with the part shown, in the corner where it covers the least.
  inset(surface, hello, frame, trail, box, shown, at) {
    const { context, colour, unit } = surface;
    const [w, h] = [Math.min(0.36 * box.w, 170 * unit), Math.min(0.36 * box.h, 100 * unit)];
    const points = [...trail.map((one) => at(...one))];
    for (const point of this.points(frame).filter(Boolean)) {
      points.push(...Array(trail.length).fill(at(...point))); // these weigh most: cover them last
    }
    const corners = [[1, 0], [0, 0], [1, 1], [0, 1]].map(([right, low]) => {
      const [x, y] = [box.x + (right ? box.w - w - 6 : 6), box.y + (low ? box.h - h - 6 : 6)];
      const covered = points.filter(([px, py]) => px > x - 8 && px < x + w + 8 && py > y - 8 && py < y + h + 8).length;
      return { x, y, w, h, covered };
    });
    const corner = corners.reduce((best, one) => (one.covered < best.covered ? one : best));
    context.fillStyle = colour.panel;
    context.strokeStyle = colour.quiet;
    context.lineWidth = 1;
    context.fillRect(corner.x, corner.y, w, h);
    const whole = this.bounds(hello, frame, trail, false);
    const small = mapping(corner, whole);
    this.contents(surface, hello, this.points(frame).slice(0, 1), [], corner, small, whole);
    context.strokeRect(corner.x, corner.y, w, h);
    const [x0, y0] = small(shown[0], shown[3]);
    const [x1, y1] = small(shown[1], shown[2]);
    context.strokeStyle = colour.ink;
    context.strokeRect(x0, y0, Math.max(x1 - x0, 3), Math.max(y1 - y0, 3));
    context.fillStyle = colour.quiet;
    context.textAlign = "left";
    context.fillText("whole", corner.x + 4, corner.y + 12 * unit);
  }

  // The last points of the path up to a time.
  trail(curves, time) {
    let end = curves.time.length;
    while (end > 0 && curves.time[end - 1] > time + 1e-9) {
      end -= 1;
    }
    const [xs, ys] = this.rows.map((one) => one.curve(curves).slice(Math.max(0, end - TRAIL), end));
    return xs.map((x, index) => [x, ys[index]]).filter((point) => !point.includes(null));
  }

  region(context, regions, lower, upper, fill, at) {
    const inside = regions.torque
      .map((torque, index) => [torque, regions[lower][index], regions[upper][index]])
      .filter(([, from, to]) => from !== null && to !== null && to >= from);
    if (!inside.length) {
      return;
    }
    context.beginPath();
    for (const [torque, from] of inside) {
      context.lineTo(...at(torque, from));
    }
    for (const [torque, , to] of inside.reverse()) {
      context.lineTo(...at(torque, to));
    }
    context.closePath();
    context.fillStyle = fill;
    context.fill();
  }

  // Torques along the visible part of the manifold.
  torques({ torque_max: most }, [left, right]) {
    const [from, to] = [Math.max(left, -most), Math.min(right, most)];
    return Array.from({ length: 121 }, (_, index) => from + ((to - from) * index) / 120);
  }

  manifold(context, manifold, colour, at, torques) {
    context.beginPath();
    for (const torque of torques) {
      context.lineTo(...at(torque, manifold.curvature * torque * torque + manifold.offset));
    }
    context.strokeStyle = colour.manifold;
    context.lineWidth = 2;
    context.stroke();
  }

  marks(context, [actual, wanted], colour, at, unit) {
    const far = 8 * unit;
    if (wanted) {
      const [x, y] = at(...wanted);
      context.beginPath();
      context.moveTo(x, y - far);
      context.lineTo(x + far, y);
      context.lineTo(x, y + far);
      context.lineTo(x - far, y);
      context.closePath();
      context.strokeStyle = colour.reference;
      context.lineWidth = 2 * unit;
      context.setLineDash([5, 2]);
      context.stroke();
      context.setLineDash([]);
    }
    if (actual) {
      const [x, y] = at(...actual);
      context.beginPath();
      context.arc(x, y, 4.5 * unit, 0, 2 * Math.PI);
      context.fillStyle = colour.angle;
      context.fill();
    }
  }

  describe(hello, frame) {
    const now = performance.now();
    if (now - this.described < 1000) {
      return;
    }
    this.described = now;
    const told = this.rows.map((one) => `${one.name} ${short(one.actual(frame), 4)} ${one.unit}, desired ${short(one.wanted(frame), 4)}`);
    this.canvas.setAttribute("aria-label", `The abstract state: ${told.join("; ")}`);
  }
}
