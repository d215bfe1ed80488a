// The Foxglove websocket protocol, as far as a page needs it: topics are advertised, subscribed, and come as messages.
const AGAIN_MS = 2000;
const MESSAGE = 1;
const ENDED = "ended";
const text = new TextDecoder();

export const address = (path) => `${path}${location.search}`;

export class Connection {
  #socket = null;
  #ids = new Map(); // topic -> channel
  #handlers = new Map(); // topic -> handler of a message
  #wanted = new Set();

  // `onEnd` gets the sentence by which the service says that nothing more comes.
  constructor(onState, onEnd) {
    Object.assign(this, { onState, onEnd });
    this.#open();
  }

  on(topic, handler, { wanted = true } = {}) {
    this.#handlers.set(topic, handler);
    if (wanted) this.#wanted.add(topic);
  }

  // Follow some topics only while they can be seen.
  follow(topics, isWanted) {
    for (const topic of topics) {
      if (isWanted === this.#wanted.has(topic)) continue;
      if (isWanted) this.#wanted.add(topic);
      else this.#wanted.delete(topic);
      const channel = this.#ids.get(topic);
      if (!channel || this.#socket?.readyState !== WebSocket.OPEN) continue;
      if (isWanted) this.#say({ op: "subscribe", subscriptions: [{ id: channel.id, channelId: channel.id }] });
      else this.#say({ op: "unsubscribe", subscriptionIds: [channel.id] });
    }
  }

  #open() {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(`${scheme}//${location.host}${location.pathname}${location.search}`, "foxglove.sdk.v1");
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.onState("connected");
    socket.onclose = () => {
      this.#ids.clear();
      this.onState("disconnected");
      setTimeout(() => this.#open(), AGAIN_MS);
    };
    socket.onmessage = ({ data }) => (typeof data === "string" ? this.#hear(JSON.parse(data)) : this.#receive(data));
    this.#socket = socket;
  }

  #hear(message) {
    if (message.op === "status" && message.id === ENDED) this.onEnd(message.message);
    if (message.op !== "advertise") return;
    for (const channel of message.channels) this.#ids.set(channel.topic, channel);
    const wanted = message.channels.filter(({ topic }) => this.#wanted.has(topic));
    this.#say({ op: "subscribe", subscriptions: wanted.map(({ id }) => ({ id, channelId: id })) });
    this.topics = new Map(message.channels.map((channel) => [channel.id, channel]));
  }

  #receive(data) {
    const view = new DataView(data);
    if (view.getUint8(0) !== MESSAGE) return;
    const channel = this.topics?.get(view.getUint32(1, true));
    const handler = channel && this.#handlers.get(channel.topic);
    if (!handler) return;
    const bytes = new Uint8Array(data, 13);
    handler(channel.encoding === "json" ? JSON.parse(text.decode(bytes)) : new DataView(data, 13), channel.topic);
  }

  #say(message) {
    this.#socket.send(JSON.stringify(message));
  }
}

// A match set in its compact form (the text of its schema is in the advertised channel).
export function readMatches(view) {
  let at = 16; // pair_id, plan_id
  const integer = () => Number(view.getBigInt64((at += 8) - 8, true));
  const count = () => view.getUint32((at += 4) - 4, true);
  const name = () => text.decode(new Uint8Array(view.buffer, view.byteOffset + at, skip(count()))) && null;
  const skip = (bytes) => { at += bytes; return bytes; };
  const numbers = () => {
    const list = [];
    for (let left = count(); left > 0; left -= 1) list.push(view.getFloat64((at += 8) - 8, true));
    return list;
  };
  skip(count()); skip(count()); // names of the clocks
  const middles = [];
  for (let rest = count(); rest > 0; rest -= 1) middles.push(integer());
  at += 24; // exposure, row time, matched
  const left = numbers(), right = numbers();
  numbers(); // sigmas
  const filled = integer();
  return { middleNs: middles, left, right, features: left.length / 2 - filled };
}
