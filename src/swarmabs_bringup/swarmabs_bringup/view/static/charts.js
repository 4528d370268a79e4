// Curves over time, drawn by uPlot (third_party/uplot).
import { colours } from "./drawing.js";

const HEIGHT = 150;
const INTERVAL = 120; // ms between two drawings of growing curves

const minus = (wanted, actual) => wanted.map((one, index) => (one === null || actual[index] === null ? null : one - actual[index]));

const CHARTS = [
  {
    place: "chart-angle",
    title: "angle and reference, rad",
    lines: [
      { label: "angle", colour: "actual", of: (c) => c.angle },
      { label: "reference", colour: "manifold", dash: [8, 5], of: (c) => c.reference },
    ],
  },
  { place: "chart-error", title: "error of the angle, rad", lines: [{ label: "reference − angle", colour: "actual", of: (c) => minus(c.reference, c.angle) }] },
  { place: "chart-torque", title: "error of the torque, N m", lines: [{ label: "wanted − torque", colour: "di", of: (c) => minus(c.desired_torque, c.torque) }] },
  { place: "chart-inertia", title: "error of the inertia, kg m²", lines: [{ label: "wanted − inertia", colour: "good", of: (c) => minus(c.desired_inertia, c.inertia) }] },
];

export class Charts {
  // `seek` is told at which time a click was.
  constructor(seek) {
    this.seek = seek;
    this.curves = { time: [], angle: [], reference: [], torque: [], desired_torque: [], inertia: [], desired_inertia: [] };
    this.steepest = 0; // the largest angle, rad
    this.drawn = 0;
    this.stale = false;
    this.build();
    new ResizeObserver(() => this.resize()).observe(document.getElementById(CHARTS[0].place));
    window.addEventListener("themechange", () => this.build());
  }

  build() {
    const colour = colours();
    for (const plot of this.plots ?? []) {
      plot.destroy();
    }
    const sync = window.uPlot.sync("time");
    this.plots = CHARTS.map(({ place, title, lines }) => {
      const node = document.getElementById(place);
      const axis = { stroke: colour.quiet, grid: { stroke: colour.grid, width: 1 }, ticks: { stroke: colour.grid, width: 1 }, font: "11px system-ui, sans-serif", values: (_, splits) => splits.map((value) => String(Number(value.toPrecision(6)))) };
      const plot = new window.uPlot(
        {
          title,
          width: Math.max(node.clientWidth, 200),
          height: HEIGHT,
          scales: { x: { time: false } },
          axes: [{ ...axis, size: 32 }, { ...axis, size: 62 }],
          series: [
            { label: "time, s" },
            ...lines.map((one) => ({ label: one.label, stroke: colour[one.colour], width: 1.6, dash: one.dash, spanGaps: false, points: { show: false } })),
          ],
          cursor: { sync: { key: sync.key }, drag: { x: true, y: false } },
        },
        this.data(lines),
        node,
      );
      const now = document.createElement("div");
      now.className = "now";
      plot.over.append(now);
      plot.now = now;
      plot.over.addEventListener("click", (event) => this.seek(plot.posToVal(event.offsetX, "x")));
      return plot;
    });
    this.mark(this.time ?? null);
  }

  data(lines) {
    return [this.curves.time, ...lines.map((one) => one.of(this.curves))];
  }

  resize() {
    for (const plot of this.plots) {
      const width = plot.root.parentElement.clientWidth;
      if (width > 0 && width !== plot.width) {
        plot.setSize({ width, height: HEIGHT });
      }
    }
    this.mark(this.time ?? null);
  }

  take(message) {
    for (const name of Object.keys(this.curves)) {
      if (message.replace) {
        this.curves[name] = message[name];
      } else {
        for (const value of message[name]) {
          this.curves[name].push(value);
        }
      }
    }
    const largest = [...message.angle, ...message.reference].reduce((most, one) => Math.max(most, Math.abs(one ?? 0)), 0);
    this.steepest = message.replace ? largest : Math.max(this.steepest, largest);
    this.stale = true;
    if (message.replace) {
      this.drawn = 0;
    }
  }

  // Draw what has come, not too often, and mark the time that is shown.
  draw(now, time) {
    if (this.stale && now - this.drawn > INTERVAL) {
      this.drawn = now;
      this.stale = false;
      this.plots.forEach((plot, index) => plot.setData(this.data(CHARTS[index].lines)));
    }
    this.mark(time);
  }

  mark(time) {
    this.time = time;
    for (const plot of this.plots) {
      const place = time === null ? -1 : plot.valToPos(time, "x");
      const inside = place >= 0 && place <= plot.over.clientWidth;
      plot.now.hidden = !inside;
      if (inside) {
        plot.now.style.transform = `translateX(${place}px)`;
      }
    }
  }
}
