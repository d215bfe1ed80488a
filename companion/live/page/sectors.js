// The nearest obstacle in each sector, the aircraft's nose up.
import { make } from "./chart.js";

const RADIUS = 92, COUNT = 72, RINGS = 4, OLD_S = 2, OLD_WITHOUT_RANGE_S = 1;

export class SectorView {
  #drawn_s = null; // by this page's clock
  #word = "";

  constructor(svg) {
    this.svg = svg;
    this.wedges = make("g", {}, svg);
    for (let ring = 1; ring <= RINGS; ring += 1) make("circle", { r: (RADIUS * ring) / RINGS, class: "axis" }, svg);
    this.labels = [2, 4].map((ring) => make("text", { x: 4, y: -(RADIUS * ring) / RINGS - 3 }, svg));
    make("path", { d: "M0,-9L6,8L0,4L-6,8Z", fill: "var(--ink)" }, svg);
  }

  draw({ distance_m, known, clear, max_m }) {
    const wedges = document.createDocumentFragment();
    let nearest_m = Infinity, looked_at = 0;
    for (let i = 0; i < COUNT; i += 1) {
      if (!known[i] && !clear[i]) continue;
      looked_at += 1;
      const share = clear[i] ? 1 : Math.min(1, distance_m[i] / max_m);
      if (known[i] && !clear[i]) nearest_m = Math.min(nearest_m, distance_m[i]);
      const [a, b] = [i - 0.5, i + 0.5].map((edge) => (edge * 2 * Math.PI) / COUNT);
      const near = [a, b].map((angle) => point(angle, RADIUS * share)), far = [b, a].map((angle) => point(angle, RADIUS));
      if (clear[i]) make("path", { d: `M0,0L${near.join("L")}Z`, fill: "var(--green)", "fill-opacity": 0.18 }, wedges);
      else {
        make("path", { d: `M0,0L${near.join("L")}Z`, fill: "var(--sky)", "fill-opacity": 0.25 }, wedges);
        make("path", { d: `M${near.join("L")}L${far.join("L")}Z`, fill: "var(--vermillion)", "fill-opacity": 0.75 }, wedges);
      }
    }
    const card = document.getElementById("obstacles");
    card.hidden = false;
    card.classList.remove("old");
    this.#drawn_s = performance.now() / 1e3;
    this.wedges.replaceChildren(wedges);
    this.labels.forEach((label, i) => { label.textContent = `${((max_m * (i + 1)) / 2).toFixed(0)} m`; });
    const empty = looked_at ? `no obstacle in ${looked_at} sectors looked at` : "nothing known";
    this.#word = Number.isFinite(nearest_m) ? `nearest ${nearest_m.toFixed(1)} m` : empty;
    document.getElementById("sectors-word").textContent = this.#word;
  }

  // What is drawn was so once: the pair after it had no sectors, or none came for long.
  doubt() {
    if (this.#drawn_s === null) return;
    document.getElementById("obstacles").classList.add("old");
    document.getElementById("sectors-word").textContent = `not known any more; last: ${this.#word}`;
  }

  // Without a range less patience: a scene that is too far for one has sectors with each pair.
  tend(has_range) {
    const age_s = this.#drawn_s === null ? 0 : performance.now() / 1e3 - this.#drawn_s;
    if (age_s > (has_range ? OLD_S : OLD_WITHOUT_RANGE_S)) this.doubt();
  }
}

const point = (angle, radius) => `${(radius * Math.sin(angle)).toFixed(1)},${(-radius * Math.cos(angle)).toFixed(1)}`;
