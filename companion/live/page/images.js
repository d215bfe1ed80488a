// Left and right image with the matched features; followed only while they are on the screen.
import { make } from "./chart.js";
import { readMatches } from "./protocol.js";

const MOST_SHOWN = 150, MATCH_SETS_KEPT = 40, PAIR_NS = 20e6;
const TOPICS = ["/camera/left", "/camera/right", "/vision/matches"];

// What stands in place of images that cannot come.
export const NO_IMAGES = { replay: "this recording has no images", demo: "this demo has no images", live: "this service runs without cameras" };

export class ImageView {
  #matches = [];
  #frames = [null, null];

  constructor(connection) {
    this.svgs = ["left", "right"].map((side) => document.getElementById(`image-${side}`));
    this.pictures = this.svgs.map((svg) => make("image", { x: 0, y: 0 }, svg));
    this.features = this.svgs.map((svg) => make("path", { fill: "none", stroke: "#ffd23f", "stroke-linecap": "round" }, svg));
    connection.on(TOPICS[0], (frame) => this.#frame(frame), { wanted: false });
    connection.on(TOPICS[1], (frame) => this.#frame(frame), { wanted: false });
    connection.on(TOPICS[2], (view) => this.#match(readMatches(view)), { wanted: false });
    let isSeen = false;
    const follow = () => connection.follow(TOPICS, isSeen && document.visibilityState === "visible");
    new IntersectionObserver(([entry]) => { isSeen = entry.isIntersecting; follow(); }).observe(document.getElementById("images"));
    document.addEventListener("visibilitychange", follow);
  }

  end() {
    const word = document.getElementById("image-word");
    word.textContent = this.#frames.some(Boolean) ? "the last images that came" : "no image came";
  }

  #frame(frame) {
    this.#frames[frame.side] = frame;
    const picture = this.pictures[frame.side], source = `data:image/${frame.format};base64,${frame.data}`;
    const probe = new Image();
    probe.onload = () => {
      const { naturalWidth: width, naturalHeight: height } = probe;
      this.svgs[frame.side].setAttribute("viewBox", `0 0 ${width} ${height}`);
      this.svgs[frame.side].style.aspectRatio = `${width} / ${height}`;
      for (const [key, value] of Object.entries({ width, height, href: source })) picture.setAttribute(key, value);
      this.features[frame.side].setAttribute("stroke-width", width / 90);
    };
    probe.src = source;
    this.#draw();
  }

  #match(matches) {
    this.#matches = [...this.#matches.slice(1 - MATCH_SETS_KEPT), matches];
    this.#draw();
  }

  // The features of the pair that is shown, by the time of its exposure.
  #draw() {
    const [left, right] = this.#frames;
    if (!left) return;
    const fits = this.#matches.findLast(({ middleNs }) => Math.abs(middleNs[0] - left.mid_exposure_ns) < PAIR_NS);
    const word = document.getElementById("image-word");
    if (!fits) {
      this.features.forEach((feature) => feature.setAttribute("d", ""));
      word.textContent = "matching";
      return;
    }
    const count = Math.min(fits.features, MOST_SHOWN), step = Math.max(1, Math.ceil(fits.features / count));
    [fits.left, fits.right].forEach((pixels, side) => {
      let path = "";
      for (let i = 0; i < fits.features; i += step) path += `M${pixels[2 * i].toFixed(1)},${pixels[2 * i + 1].toFixed(1)}h0`;
      this.features[side].setAttribute("d", right || side === 0 ? path : "");
    });
    document.getElementById("matches").textContent = `${fits.features} matched features`;
    word.textContent = "two pairs a second, while this is on the screen";
  }
}
