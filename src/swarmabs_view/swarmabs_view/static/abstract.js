// The abstract state, torque and inertia, with its manifold and the sets A_A and A_P.
import { colours, prepared, short, ticks } from "./drawing.js";

const FONT = "11px system-ui, sans-serif";
const LEFT = 52; // px of the labels on the left and their title, at least
const TITLE = 26; // px of it for the title, ticks and gaps
const BOTTOM = 34;
const TOP = 10;
const RIGHT = 12;
const TRAIL = 400;

export class AbstractView {
  constructor(canvas) {
    this.canvas = canvas;
    this.near = true;
    this.left = LEFT;
  }

  bounds(hello, frame, trail, near) {
    const known = [frame.abstract, frame.desired].filter((one) => one.torque !== null && one.inertia !== null);
    const points = [...trail, ...known.map((one) => [one.torque, one.inertia])];
    let [left, right] = [Infinity, -Infinity];
    let [low, high] = [Infinity, -Infinity];
    for (const [torque, inertia] of points) {
      left = Math.min(left, torque);
      right = Math.max(right, torque);
      low = Math.min(low, inertia);
      high = Math.max(high, inertia);
    }
    const manifold = hello.manifold;
    if (near && points.length) {
      const [dx, dy] = [Math.max(0.1 * (right - left), 0.02), Math.max(0.1 * (high - low), 0.001)];
      return [left - dx, right + dx, Math.max(0, low - dy), high + dy];
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

  draw(hello, frame, curves) {
    const { context, width, height } = prepared(this.canvas);
    const colour = colours();
    const trail = this.trail(curves, frame.time);
    const shown = this.bounds(hello, frame, trail, this.near);
    const inertias = ticks(shown[2], shown[3], Math.max(2, height / 60));
    context.font = FONT;
    this.left = Math.max(this.left, TITLE + Math.ceil(Math.max(0, ...inertias.map((one) => context.measureText(one).width))));
    const box = { x: this.left, y: TOP, w: width - this.left - RIGHT, h: height - TOP - BOTTOM };
    const at = this.mapping(box, shown);
    this.contents(context, hello, frame, trail, colour, box, at, shown);
    this.axes(context, colour, at, box, shown, inertias);
    if (this.near && hello.manifold && trail.length) {
      this.inset(context, hello, frame, trail, colour, box, shown, at);
    }
    this.describe(hello, frame);
  }

  mapping({ x, y, w, h }, [left, right, low, high]) {
    return (torque, inertia) => [
      x + ((torque - left) / (right - left)) * w,
      y + (1 - (inertia - low) / (high - low)) * h,
    ];
  }

  contents(context, hello, frame, trail, colour, { x, y, w, h }, at, shown) {
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
    context.lineWidth = 1.5;
    context.lineJoin = "round";
    context.beginPath();
    trail.forEach(([torque, inertia]) => context.lineTo(...at(torque, inertia)));
    context.stroke();
    context.lineJoin = "miter";
    this.marks(context, frame, colour, at);
    context.restore();
  }

  // An inset of the whole manifold with the part shown, in the corner where it covers the least.
  inset(context, hello, frame, trail, colour, box, shown, at) {
    const [w, h] = [Math.min(0.36 * box.w, 170), Math.min(0.36 * box.h, 100)];
    const points = [...trail.map((one) => at(...one))];
    for (const { torque, inertia } of [frame.abstract, frame.desired]) {
      if (torque !== null && inertia !== null) {
        points.push(...Array(trail.length).fill(at(torque, inertia))); // these weigh most: cover them last
      }
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
    const small = this.mapping(corner, whole);
    this.contents(context, hello, { ...frame, desired: { torque: null, inertia: null } }, [], colour, corner, small, whole);
    context.strokeRect(corner.x, corner.y, w, h);
    const [x0, y0] = small(shown[0], shown[3]);
    const [x1, y1] = small(shown[1], shown[2]);
    context.strokeStyle = colour.ink;
    context.strokeRect(x0, y0, Math.max(x1 - x0, 3), Math.max(y1 - y0, 3));
    context.fillStyle = colour.quiet;
    context.textAlign = "left";
    context.fillText("whole", corner.x + 4, corner.y + 12);
  }

  // The last points of the path up to a time.
  trail(curves, time) {
    let end = curves.time.length;
    while (end > 0 && curves.time[end - 1] > time + 1e-9) {
      end -= 1;
    }
    const found = [];
    for (let index = Math.max(0, end - TRAIL); index < end; index += 1) {
      if (curves.torque[index] !== null && curves.inertia[index] !== null) {
        found.push([curves.torque[index], curves.inertia[index]]);
      }
    }
    return found;
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

  axes(context, colour, at, { x: begin, y: top, w, h }, [left, right, low], inertias) {
    context.font = FONT;
    context.lineWidth = 1;
    context.strokeStyle = colour.line;
    context.fillStyle = colour.quiet;
    context.textAlign = "center";
    for (const torque of ticks(left, right, Math.max(2, w / 60))) {
      const [x, y] = at(torque, low);
      context.beginPath();
      context.moveTo(x, y);
      context.lineTo(x, y + 4);
      context.stroke();
      const text = String(torque);
      context.fillText(text, Math.min(x, begin + w + RIGHT - context.measureText(text).width / 2), y + 15);
    }
    context.textAlign = "right";
    for (const inertia of inertias) {
      const [x, y] = at(left, inertia);
      context.beginPath();
      context.moveTo(x, y);
      context.lineTo(x - 4, y);
      context.stroke();
      context.fillText(String(inertia), x - 6, y + 4);
    }
    context.textAlign = "center";
    context.fillText("torque, N m", begin + w / 2, top + h + BOTTOM - 4);
    context.save();
    context.translate(11, top + h / 2);
    context.rotate(-Math.PI / 2);
    context.fillText("inertia, kg m²", 0, 0);
    context.restore();
    context.strokeRect(begin, top, w, h);
  }

  marks(context, frame, colour, at) {
    const { abstract, desired } = frame;
    if (desired.torque !== null && desired.inertia !== null) {
      const [x, y] = at(desired.torque, desired.inertia);
      context.beginPath();
      context.moveTo(x, y - 8);
      context.lineTo(x + 8, y);
      context.lineTo(x, y + 8);
      context.lineTo(x - 8, y);
      context.closePath();
      context.strokeStyle = colour.reference;
      context.lineWidth = 2;
      context.setLineDash([5, 2]);
      context.stroke();
      context.setLineDash([]);
    }
    if (abstract.torque !== null && abstract.inertia !== null) {
      const [x, y] = at(abstract.torque, abstract.inertia);
      context.beginPath();
      context.arc(x, y, 4.5, 0, 2 * Math.PI);
      context.fillStyle = colour.angle;
      context.fill();
    }
  }

  describe(hello, frame) {
    const now = performance.now();
    if (now - (this.described ?? -1e9) < 1000) {
      return;
    }
    this.described = now;
    const { abstract, desired } = frame;
    const text = `The abstract state: torque ${short(abstract.torque, 4)} newton metres, desired ${short(desired.torque, 4)}; inertia ${short(abstract.inertia, 4)} kilogram square metres, desired ${short(desired.inertia, 4)}`;
    this.canvas.setAttribute("aria-label", text);
  }
}
