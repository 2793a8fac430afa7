// Drawings of the pages, as SVG: <undrift-drawing kind="box" what='["+z", "+"]'> is drawn anew when one of both changes.
const HALF = [62, 44, 22];  // of the box along x, y and z
const FILLS = { z: 0.06, x: 0.14, y: 0.24 };  // of the three sides that are seen, by how they are lit
const SHAPES = {  // of the light: the colour is never the only sign
  "no readings": ["bad", '<path d="M12 12 L36 36 M36 12 L12 36" stroke="C" stroke-width="6"/>'],
  moving: ["ink", '<path d="M6 16 h30 l-8 -8 M42 32 h-30 l8 8" stroke="C" stroke-width="5"/>'],
  settling: ["marginal", '<path d="M24 6 a18 18 0 0 1 0 36 z" fill="C"/><path d="M24 6 a18 18 0 0 0 0 36" stroke="C" stroke-width="4"/>'],
  still: ["good", '<circle cx="24" cy="24" r="19" fill="C"/>'],
  captured: ["good", '<path d="M8 26 l11 11 l21 -26" stroke="C" stroke-width="7"/>'],
  "wrong face": ["marginal", '<path d="M10 24 a14 14 0 1 1 6 12 M16 44 v-9 h9" stroke="C" stroke-width="5"/>'],
  tilted: ["marginal", '<path d="M5 40 h38 M8 38 L40 22" stroke="C" stroke-width="5"/>'],
  "unknown face": ["marginal", '<path d="M16 16 a8 8 0 1 1 9 9 v6 M25 39 v2" stroke="C" stroke-width="5"/>'],
};
const path = (points) => "M" + points.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`).join(" L");
const picture = (box, words, width, drawn) => `<svg class="device" viewBox="${box}" role="img" aria-label="${words}"><g fill="none"
  stroke="currentColor" stroke-width="${width}" stroke-linejoin="round" stroke-linecap="round">${drawn}</g></svg>`;
const arrowhead = ([x0, y0], [x1, y1], length, spread) => {
  const angle = Math.atan2(y1 - y0, x1 - x0);
  return [spread, -spread].map((s) => [x1 - length * Math.cos(angle + s), y1 - length * Math.sin(angle + s)]);
};

// A vector of the box as it stands with a face up: z up, the other axes follow round.
function standing(face, v) {
  const k = "xyz".indexOf(face[1]), [a, b, up] = [v[(k + 1) % 3], v[(k + 2) % 3], v[k]];
  return face[0] === "+" ? [a, b, up] : [a, -b, -up];
}
// Where a point is drawn: seen from the front, the right and above.
const onScreen = ([x, y, z]) => [0.87 * (y - x), 0.38 * (x + y) - 0.9 * z];

// The sides of a box that are seen, as it stands by a turn of its vectors, with their names.
function sides(turned) {
  const drawn = [];
  for (const axis of Object.keys(FILLS)) for (const sign of [1, -1]) {
    const k = "xyz".indexOf(axis), normal = [0, 0, 0];
    normal[k] = sign;
    const seen = turned(normal), [x2, y2, z2] = seen.map((part) => part * part), top = seen[2] > 0.7;
    if (seen[0] + seen[1] + 0.844 * seen[2] < 1e-3) continue;  // on the far side
    const corners = [[1, 1], [1, -1], [-1, -1], [-1, 1]].map(([one, other]) => {
      const corner = [0, 0, 0];
      [corner[k], corner[(k + 1) % 3], corner[(k + 2) % 3]] = [sign, one, other];
      return onScreen(turned(corner.map((part, i) => part * HALF[i])));
    });
    const [x, y] = [0, 1].map((i) => corners.reduce((sum, corner) => sum + corner[i], 0) / 4);
    drawn.push(`<path d="${path(corners)} Z" fill="currentColor" fill-opacity="${(FILLS.x * x2 + FILLS.y * y2 + FILLS.z * z2).toFixed(3)}"/>`);
    drawn.push(`<text x="${x.toFixed(1)}" y="${(y + (top ? 9 : 6)).toFixed(1)}" class="${top ? "top" : "side"}">${sign > 0 ? "+" : "-"}${axis}</text>`);
  }
  return drawn;
}

function box(face, turn = "") {
  const drawn = sides((v) => standing(face, v)), height = -0.9 * HALF["xyz".indexOf(face[1])];
  if (turn) {  // an arrow round the axis that is up; counter-clockwise, seen from above, for +
    const way = turn === "+" ? 1 : -1;
    const points = Array.from({ length: 49 }, (_, k) => 0.1 * (k - 24)).map((a) => [58 * Math.sin(way * a), height - 34 + 19 * Math.cos(way * a)]);
    const [one, other] = arrowhead(points[45], points[48], 15, 0.55);
    for (const line of [points, [one, points[48], other]]) drawn.push(`<path class="act" d="${path(line)}" stroke-width="5"/>`);
  } else drawn.push(`<path class="act" d="M0 ${(height - 22).toFixed(1)} v-34 m-9 11 l9 -11 l9 11" stroke-width="5"/>`);
  const turned = turn ? `, turned ${turn === "+" ? "counter-clockwise" : "clockwise"} seen from above` : "";
  return picture("-115 -125 230 210", `Box with ${face} up${turned}`, 2, drawn.join(""));
}

function lamp(state) {
  const [colour, shape] = SHAPES[state];
  return `<svg class="lamp" viewBox="0 0 48 48" aria-hidden="true">${shape.replaceAll("C", `var(--${colour})`)}</svg>`;
}

// The countdown as a ring that closes, with the seconds left; nothing in its place where nothing counts down.
function ring(left, whole) {
  if (left === null) return '<svg class="ring" viewBox="0 0 100 100" aria-hidden="true"></svg>';
  const share = Math.min(Math.max(1 - left / whole, 0), 1), around = 2 * Math.PI * 40, circle = '<circle cx="50" cy="50" r="40"';
  return `<svg class="ring" viewBox="0 0 100 100" aria-hidden="true">${circle}/>${circle} class="gone"
    stroke-dasharray="${(around * share).toFixed(1)} ${around.toFixed(1)}"/><text x="50" y="63">${Math.ceil(left)}</text></svg>`;
}

const DRAWINGS = { box, lamp, ring };
customElements.define("undrift-drawing", class extends HTMLElement {
  static observedAttributes = ["kind", "what"];
  connectedCallback() { this.attributeChangedCallback(); }
  attributeChangedCallback() {
    const what = this.getAttribute("what");
    if (this.getAttribute("kind") && what) this.innerHTML = DRAWINGS[this.getAttribute("kind")](...JSON.parse(what));
  }
});
