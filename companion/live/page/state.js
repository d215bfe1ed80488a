// The newest records and a minute of history, and the service's clock as this page sees it.
const WINDOW_S = 60;
const SECOND_NS = 1e9;
const LOST_S = 0.6; // further off: the service was paused, or its time is simulated

export class Clock {
  #ahead_s = null; // service's time less this page's
  #stopped_s = null;

  hear(host_ns) {
    const ahead_s = host_ns / SECOND_NS - performance.now() / 1e3;
    const off_s = this.#ahead_s === null ? Infinity : ahead_s - this.#ahead_s;
    this.#ahead_s = Math.abs(off_s) > LOST_S ? ahead_s : this.#ahead_s + (off_s > 0 ? off_s : 0.01 * off_s);
  }

  // From here on it is the last moment.
  stop() {
    this.#stopped_s ??= this.now_s();
  }

  now_s() {
    if (this.#stopped_s !== null) return this.#stopped_s;
    return this.#ahead_s === null ? 0 : this.#ahead_s + performance.now() / 1e3;
  }
}

export class History {
  points = [];

  add(t_s, values) {
    const last = this.points.at(-1);
    if (last && t_s < last.t_s - 5) this.points = []; // another service, or the recording anew
    this.points.push({ t_s, ...values });
    while (this.points.length && this.points[0].t_s < t_s - WINDOW_S) this.points.shift();
  }
}

// One mode at a time: q = slow + amplitude cos(phase).
export class Swing {
  #mode = null;
  #at_s = 0;

  hear(mode, at_s) {
    this.#mode = mode;
    this.#at_s = at_s;
  }

  get mode() {
    return this.#mode;
  }

  phase(t_s) {
    return this.#mode ? this.#mode.phase_rad + 2 * Math.PI * this.#mode.instantaneous_hz * (t_s - this.#at_s) : 0;
  }

  value_m(t_s) {
    return this.#mode ? this.#mode.amplitude_m * Math.cos(this.phase(t_s)) : 0;
  }
}

export const window_s = WINDOW_S;
