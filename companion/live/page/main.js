// The page: topics in, views out.
import { Chart } from "./chart.js";
import { Parameters, Recordings } from "./controls.js";
import { ImageView, NO_IMAGES } from "./images.js";
import { PhaseView } from "./phase.js";
import { Connection, address } from "./protocol.js";
import { SectorView } from "./sectors.js";
import { Clock, History, Swing } from "./state.js";
import { Events, Health } from "./tables.js";
import { WingView } from "./wing.js";

const DRAW_MS = 200, STALE_S = 2.5, SKIP = "skip", SAME_SHOT_NS = 20e6;
const $ = (id) => document.getElementById(id);
const clock = new Clock(), ranges = new History(), modes = new History();
const swings = [new Swing(), new Swing()];
const shots = { fired: 0, skipped: 0, exposed_ns: -Infinity };
const SINCE = { replay: "into the recording", demo: "into the flight", live: "since the start" };
let state = { plan: null, slow_m: [0, 0], heard_s: -Infinity, range: null, first_s: null, ended: "" };

const duration = (s) => {
  const [hours, minutes, seconds] = [s / 3600, (s / 60) % 60, s % 60].map((part) => Math.floor(part));
  const two = (number) => String(number).padStart(2, "0");
  return hours ? `${hours}:${two(minutes)}:${two(seconds)}` : `${minutes}:${two(seconds)}`;
};
const signed = (value, digits) => `${value < 0 ? "\u2212" : "+"}${Math.abs(value).toFixed(digits)}`;

function judgeRange({ trusted, matches, reject }) {
  const words = trusted ? `trusted, ${matches} matches` : `not published: ${reject}`;
  $("range-word").textContent = state.ended ? `last range: ${words}` : words;
  $("range-now").classList.toggle("withheld", !trusted);
}

function showRange(range, sectors) {
  if (!range.trusted) sectors.doubt(); // its own sectors, if it has any, come behind it
  state.range = range;
  ranges.add(range.t_host_ns / 1e9, { range_m: range.range_m, sigma_m: range.sigma_m, rigid_m: range.rigid_range_m, trusted: range.trusted });
  $("range-now").innerHTML = `${range.range_m.toFixed(2)} <small>\u00b1 ${range.sigma_m.toFixed(2)} m</small>`;
  judgeRange(range);
  $("rigid-now").textContent = range.rigid_range_m > 0 ? `${range.rigid_range_m.toFixed(1)} m` : "beyond infinity";
  $("toe-now").innerHTML = `${signed(1e3 * range.toe_rad, 2)} <small>\u00b1 ${(1e3 * range.toe_sigma_rad).toFixed(2)} mrad</small>`;
}

function showMode(mode) {
  const at_s = mode.t_host_ns / 1e9;
  clock.hear(mode.t_host_ns);
  [mode.symmetric, mode.antisymmetric].forEach((each, i) => {
    swings[i].hear(each, at_s);
    state.slow_m[i] = mode.q_m[i] - each.amplitude_m * Math.cos(each.phase_rad);
  });
  modes.add(at_s, { modes: [mode.symmetric, mode.antisymmetric] });
  $("phase-word").textContent = `${mode.symmetric.frequency_hz.toFixed(2)} Hz, ${mode.validity}`;
}

function showStatus(status, health) {
  state.heard_s = performance.now() / 1e3;
  clock.hear(status.at_host_ns);
  health.status(status);
  if (state.ended) return; // that is said before what still waits comes
  $("health").textContent = status.health;
  $("health").className = `pill ${status.health}`;
  $("reason").textContent = status.reason;
}

function showPlan(plan) {
  clock.hear(plan.planned_host_ns);
  state.plan = plan;
  if (plan.firing === SKIP) shots.skipped += 1;
}

// The smoothed deflection at an exposure tells its phase better than the tracker's swing, carried on, would.
function showExposure({ t_host_ns, q_m, qdot_mps }, view) {
  if (!swings[0].mode || Math.abs(t_host_ns - shots.exposed_ns) < SAME_SHOT_NS) return;
  shots.exposed_ns = t_host_ns;
  const turn_radps = 2 * Math.PI * swings[0].mode.frequency_hz;
  view.shot(Math.atan2(-qdot_mps[0] / turn_radps, q_m[0] - state.slow_m[0]));
}

function charts(kind, sectors) {
  const near = (points) => {
    const sizes = points.map(({ range_m }) => range_m).sort((a, b) => a - b);
    return [0, sizes.length ? Math.max(10, 1.7 * sizes[Math.floor(sizes.length / 2)]) : 100];
  };
  const range = new Chart($("range-chart"),
    [{ color: "var(--blue)", value: (p) => (p.trusted ? p.range_m : null), sigma: (p) => 2 * p.sigma_m }],
    { limits: near, unit: " m", dots: [
      { color: "var(--vermillion)", value: (p) => (p.rigid_m > 0 ? p.rigid_m : Infinity) },
      { color: "var(--grey)", hollow: true, value: (p) => (p.trusted ? null : p.range_m) }] });
  const pair = (svg, value, sigma, limits) => new Chart(svg,
    [0, 1].map((i) => ({ color: i ? "var(--orange)" : "var(--blue)", value: (p) => value(p.modes[i]), sigma: (p) => sigma(p.modes[i]) })), { limits });
  const most = (points) => [0, Math.max(1, ...points.flatMap((p) => p.modes.map((m) => 1.1e3 * m.amplitude_m)))];
  const around = (points) => {
    const all = points.flatMap((p) => p.modes.map((m) => m.frequency_hz));
    return all.length ? [Math.max(0, Math.min(...all) - 0.6), Math.max(...all) + 0.6] : [0, 10];
  };
  const amplitude = pair($("amplitude-chart"), (m) => 1e3 * m.amplitude_m, (m) => 1e3 * m.amplitude_sigma_m, most);
  const frequency = pair($("frequency-chart"), (m) => m.frequency_hz, (m) => m.frequency_sigma_hz, around);
  return () => {
    const now_s = clock.now_s(), edge = state.ended ? "end" : "now";
    range.draw(ranges.points, now_s, edge);
    amplitude.draw(modes.points, now_s, edge);
    frequency.draw(modes.points, now_s, edge);
    if (state.first_s !== null && now_s > 0) $("time").textContent = duration(Math.max(0, now_s - state.first_s));
    $("shots").textContent = shots.fired + shots.skipped ? `${shots.fired} shots, ${shots.skipped} peaks skipped since this page opened.` : "No shot yet.";
    if (state.ended) return;
    sectors.tend(true);
    const isFresh = performance.now() / 1e3 - state.heard_s < STALE_S;
    if (!isFresh && state.heard_s > 0) $("link").textContent = "nothing comes";
    else if (isFresh) $("link").textContent = kind;
    $("link-dot").classList.toggle("on", isFresh);
  };
}

function animate(wing, phase) {
  const now_s = clock.now_s();
  if (swings[0].mode) {
    const [symmetric_m, antisymmetric_m] = swings.map((swing, i) => state.slow_m[i] + swing.value_m(now_s));
    const tips = [symmetric_m - antisymmetric_m, symmetric_m + antisymmetric_m];
    wing.draw(tips);
    const { amplitude_m, phase_sigma_rad } = swings[0].mode;
    const highest_m = Math.max(1e-4, ...modes.points.map((p) => p.modes[0].amplitude_m));
    const plan = state.plan, planned_s = plan && plan.firing !== SKIP ? plan.exposure_host_ns / 1e9 : null;
    const planned = planned_s !== null && Math.abs(planned_s - now_s) < 1 ? swings[0].phase(planned_s) : null;
    phase.draw(swings[0].phase(now_s), phase_sigma_rad, Math.max(0.15, amplitude_m / highest_m), planned);
    $("bend-now").innerHTML = `${signed(1e3 * 2 * wing.about.modes[0].slope_factor_radpm * symmetric_m, 1)} <small>mrad</small>`;
    $("swing-now").innerHTML = `${(1e3 * amplitude_m).toFixed(1)} <small>mm at ${swings[0].mode.frequency_hz.toFixed(2)} Hz</small>`;
  }
  requestAnimationFrame(() => animate(wing, phase));
}

// Nothing more comes: what stands here are last values, and no alarm.
function end(sentence, images) {
  if (state.ended) return;
  state.ended = sentence;
  clock.stop();
  document.body.classList.add("ended");
  $("health").className = "pill";
  $("health").textContent = $("link").textContent = "ended";
  $("reason").textContent = state.heard_s > 0 ? `${sentence}; these are its last values` : sentence;
  if (state.range) judgeRange(state.range); // behind it came only that the streams have stopped
  for (const place of document.querySelectorAll(".moment")) place.textContent = "at the end";
  images?.end();
}

// After a pause: the same service goes on, it has ended meanwhile, or another has begun.
async function connected(parameters, images) {
  const about = await parameters.refresh();
  if (about?.ended) end(about.ended, images);
  else if (about && state.ended) location.reload();
}

async function start() {
  const answer = await fetch(address("about.json"));
  if (!answer.ok) {
    $("reason").textContent = (await answer.text()).trim();
    return;
  }
  const about = await answer.json();
  $("who").textContent = `${about.airframe}, ${about.title}`;
  $("software").textContent = `Spanwise ${about.software}`;
  $("address").textContent = `ws://${location.host}/`;
  document.title = `Spanwise ${about.airframe}`;
  const wing = new WingView($("wing"), about), phase = new PhaseView($("phase")), sectors = new SectorView($("sectors"));
  const health = new Health(about), events = new Events(), parameters = new Parameters(about);
  new Recordings(about);
  wing.draw([0, 0]);
  if (!wing.looksDown) $("bend-word").textContent = "roll of the cameras against each other by bending";
  $("since").textContent = SINCE[about.kind];
  if (about.began_host_ns !== null) state.first_s = about.began_host_ns / 1e9;
  let images = null;
  const connection = new Connection((word) => {
    if (word === "connected") connected(parameters, images);
    if (state.ended) return;
    $("link").textContent = word;
    if (word === "disconnected") { $("health").className = "pill"; $("health").textContent = "no data"; $("reason").textContent = "the service does not answer; tried again every two seconds"; }
  }, (sentence) => end(sentence, images));
  const seconds = (host_ns) => host_ns / 1e9 - (state.first_s ??= host_ns / 1e9);
  connection.on("/wing/mode", showMode);
  connection.on("/range/corrected", (range) => showRange(range, sectors));
  connection.on("/range/none", ({ reject }) => {
    if (state.ended) return;
    $("range-word").textContent = `none: ${reject}`;
    $("range-now").classList.add("withheld");
    sectors.tend(false);
  });
  connection.on("/range/sectors", (record) => sectors.draw(record));
  connection.on("/trigger/plan", showPlan);
  connection.on("/trigger/shot", () => { shots.fired += 1; });
  connection.on("/wing/deflection", (deflection) => showExposure(deflection, phase));
  connection.on("/status/service", (status) => { seconds(status.at_host_ns); showStatus(status, health); });
  connection.on("/status/notice", ({ severity, text, at_host_ns }) => events.add(severity, text, seconds(at_host_ns)));
  connection.on("/time/clock", (record) => health.clock(record));
  connection.on("/parameter", ({ name, value, changed_host_ns }) => {
    parameters.set(name, value);
    events.add(6, `${name} is ${value} now`, seconds(changed_host_ns));
  });
  for (const [severity, text, at_host_ns] of about.events) events.add(severity, text, seconds(at_host_ns));
  if (about.has_images) images = new ImageView(connection);
  else { document.querySelector("#images .pair").hidden = true; $("image-word").textContent = NO_IMAGES[about.kind]; }
  setInterval(charts(about.kind, sectors), DRAW_MS);
  animate(wing, phase);
}

start().catch((error) => { $("reason").textContent = error.message; });
