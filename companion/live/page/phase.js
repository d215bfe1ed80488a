// The phase circle: where the swing is, where the next exposure is planned, where the last shots fell.
import { make } from "./chart.js";

const RADIUS = 84, KEPT = 40;

// Phase 0, the tips highest, is at the top, and time runs clockwise.
const at = (phase, radius) => [radius * Math.sin(phase), -radius * Math.cos(phase)];

export class PhaseView {
  #shots = [];

  constructor(svg) {
    make("circle", { r: RADIUS, class: "axis", "stroke-width": 1.5 }, svg);
    make("path", { class: "axis", d: `M0,${-RADIUS}V${RADIUS}M${-RADIUS},0H${RADIUS}`, "stroke-dasharray": "3 5" }, svg);
    for (const [words, y] of [["tips highest", -RADIUS - 9], ["tips lowest", RADIUS + 17]]) {
      make("text", { x: 0, y, "text-anchor": "middle" }, svg).textContent = words;
    }
    this.sigma = make("path", { fill: "var(--blue)", "fill-opacity": 0.16 }, svg);
    this.fired = make("g", { fill: "var(--orange)" }, svg);
    this.plan = make("path", { d: "M0,-9L7,0L0,9L-7,0Z", fill: "var(--green)", visibility: "hidden" }, svg);
    this.needle = make("line", { x1: 0, y1: 0, stroke: "var(--blue)", "stroke-width": 5, "stroke-linecap": "round" }, svg);
    make("circle", { r: 5, fill: "var(--blue)" }, svg);
  }

  shot(phase) {
    this.#shots = [...this.#shots.slice(1 - KEPT), phase];
    this.fired.replaceChildren();
    this.#shots.forEach((each, i) => {
      const [cx, cy] = at(each, RADIUS);
      make("circle", { cx, cy, r: 4.5, "fill-opacity": 0.15 + (0.75 * (i + 1)) / this.#shots.length }, this.fired);
    });
  }

  draw(phase, sigma, share, planned) {
    const [x, y] = at(phase, RADIUS * share);
    this.needle.setAttribute("x2", x);
    this.needle.setAttribute("y2", y);
    const spread = Math.min(Math.PI - 0.01, sigma);
    const [ax, ay] = at(phase - spread, RADIUS), [bx, by] = at(phase + spread, RADIUS);
    this.sigma.setAttribute("d", `M0,0L${ax},${ay}A${RADIUS},${RADIUS} 0 ${spread > Math.PI / 2 ? 1 : 0} 1 ${bx},${by}Z`);
    this.plan.setAttribute("visibility", planned === null ? "hidden" : "visible");
    if (planned !== null) this.plan.setAttribute("transform", `translate(${at(planned, RADIUS)})`);
  }
}
