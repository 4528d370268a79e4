// Robots on a parent system other than the plane: along a line or in a plan view, with the outline of the system.
import { capital, roles, titled } from "./description.js";
import { axes, colours, framed, mapping, prepared, short, ticks } from "./drawing.js";
import { PlaneView } from "./plane.js";
import { STATUS } from "./tables.js";

const SPACE = 0.12; // around what is drawn, of its size
const LOOSEST = 3; // size of the part shown, over that of what is drawn, from which on the scale follows

// The range shown of an axis: it changes only when something is outside, or everything has become much smaller.
function kept(held, values) {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const size = Math.max(high - low, 0.01);
  if (held && held[0] <= low && high <= held[1] && held[1] - held[0] <= LOOSEST * size) {
    return held;
  }
  return [low - SPACE * size, high + SPACE * size];
}

// Extend bounds to equal scales on both axes of a box.
function square([left, right, low, high], { w, h }) {
  const size = Math.max((right - left) / w, (high - low) / h); // of a px
  const [x, y] = [(left + right) / 2, (low + high) / 2];
  return [x - (size * w) / 2, x + (size * w) / 2, y - (size * h) / 2, y + (size * h) / 2];
}

export class SystemView extends PlaneView {
  hello() {
    this.across = this.up = null;
    [this.left, this.described] = [0, -Infinity];
  }

  crowded(hello) {
    return !hello.system && super.crowded(hello);
  }

  draw(hello, frame) {
    if (!hello.system) {
      super.draw(hello, frame);
      return;
    }
    const { context, width, height } = prepared(this.canvas);
    const colour = colours();
    const { position } = frame.robots;
    const robots = position.filter(Boolean);
    const lanes = !frame.outline.length && robots.every((point) => point.length < 2);
    const points = this.fit && robots.length ? robots : [[0, 0], ...frame.outline.flat(), ...robots];
    this.across = kept(this.across, points.map(([x]) => x));
    this.up = lanes ? [0, 1] : kept(this.up, points.map(([, y]) => y ?? 0));
    const marks = lanes ? [] : ticks(...this.up, Math.max(2, height / 60));
    const box = framed(context, width, height, marks, this.left);
    this.left = box.x;
    const shown = lanes ? [...this.across, ...this.up] : square([...this.across, ...this.up], box);
    const place = mapping(box, shown);
    const at = lanes ? ([x], depth) => place(x, 1 - depth) : ([x, y]) => place(x, y ?? 0);
    const titles = hello.system.placed ? ["x", "y"] : roles(hello.system).robot.map(titled);
    axes(context, colour, place, box, shown, marks, lanes ? [titles[0], ""] : [titles[0], titles[1] ?? ""]);
    context.save();
    context.beginPath();
    context.rect(box.x, box.y, box.w, box.h);
    context.clip();
    context.strokeStyle = colour.edge;
    context.lineWidth = 2;
    for (const line of frame.outline) {
      context.beginPath();
      line.forEach((point) => context.lineTo(...place(...point)));
      context.stroke();
    }
    context.restore();
    this.robots(context, hello, frame, at, colour, box.h / (lanes ? hello.robots.length : this.fit ? 8 : 16));
    this.tell();
    this.describe(hello, frame);
  }

  // Name a robot with its status and coordinates.
  said({ robots, system }, frame, index) {
    const { status, coordinates } = frame.robots;
    const places = system && roles(system).robot.map((one, axis) => `${titled(one)} ${short(coordinates[index][axis], 4)}`);
    return system ? `robot ${robots[index].id}: ${STATUS[status[index]] ?? "no data"}; ${places.join("; ")}` : super.said({ robots }, frame, index);
  }

  told(hello, frame) {
    return hello.system ? `${capital(hello.system.name)} at ${short(frame.time, 4)} s` : super.told(hello, frame);
  }
}
