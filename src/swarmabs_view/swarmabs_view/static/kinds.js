// The kinds of robots: how the page names and draws them, and the unit of their command along a coordinate.

export const KINDS = {
  single_integrator: { words: "velocity (SI)", legend: "velocity-driven (SI)", colour: "si", shape: "circle", command: (unit) => `${unit}/s` },
  double_integrator: { words: "force (DI)", legend: "force-driven (DI)", colour: "di", shape: "square", command: (unit) => (unit === "m" ? "N" : `kg ${unit}/s²`) },
  first_order_lag: { words: "lag", legend: "with lag", colour: "inertia", shape: "diamond", command: (unit) => unit },
};

const SHAPES = {
  circle: (path, x, y, size) => path.arc(x, y, size, 0, 2 * Math.PI),
  square: (path, x, y, size) => {
    const side = size * Math.sqrt(Math.PI); // of the same area
    path.rect(x - side / 2, y - side / 2, side, side);
  },
  diamond: (path, x, y, size) => {
    const far = 1.25 * size; // of the same area
    [[-far, 0], [0, -far], [far, 0], [0, far], [-far, 0]].forEach(([dx, dy]) => path.lineTo(x + dx, y + dy));
  },
};
const SIGNS = {
  circle: ["circle", { cx: 8, cy: 8, r: 6 }],
  square: ["rect", { x: 2.5, y: 2.5, width: 11, height: 11 }],
  diamond: ["path", { d: "M8 0.5 15.5 8 8 15.5 0.5 8Z" }],
};
const SVG = "http://www.w3.org/2000/svg";

// Add the outline of a robot of a kind to the path of a context.
export function outline(context, kind, x, y, size) {
  SHAPES[KINDS[kind].shape](context, x, y, size);
}

// Return an entry of the legend for each kind, with the kind as its class.
export function legend() {
  return Object.entries(KINDS).map(([kind, { legend: text, colour, shape }]) => {
    const item = Object.assign(document.createElement("li"), { className: kind });
    const sign = drawn("svg", { viewBox: "0 0 16 16", "aria-hidden": true });
    sign.append(drawn(...SIGNS[shape]));
    sign.style.fill = `var(--${colour})`;
    item.append(sign, text);
    return item;
  });
}

function drawn(tag, attributes) {
  const element = document.createElementNS(SVG, tag);
  Object.entries(attributes).forEach(([name, value]) => element.setAttribute(name, value));
  return element;
}
