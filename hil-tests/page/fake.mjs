// A small server that speaks the page's protocol, with a made-up rig: it lets the browser test run without the program.

import { createServer } from "node:http";
import { createRequire } from "node:module";
import { readFileSync, writeFileSync } from "node:fs";
import { extname, join } from "node:path";

export const TOKEN = "0123456789abcdef0123456789abcdef";
const PAGE = new URL("../../src/view/page/", import.meta.url).pathname;
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml" };
const FILES = ["/index.html", "/view.js", "/records.js", "/pen.js", "/scene.js", "/charts.js", "/play.js", "/view.css", "/uplot.js", "/uplot.css", "/favicon.svg"];
const HEADERS = {
  "Content-Security-Policy": "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
  "X-Content-Type-Options": "nosniff",
  "Cross-Origin-Resource-Policy": "same-origin",
  "Cross-Origin-Opener-Policy": "same-origin",
  "Referrer-Policy": "no-referrer",
  "Cache-Control": "no-store",
};

const STATE = { idle: 0, enabling: 1, running: 2, holding: 3, stopping: 4, stopped: 5, disabled: 6, lost: 7 };
const DRIVE = { "switched-on": 3, "operation-enabled": 4, "quick-stop-active": 5, fault: 7 };
const FAULTS = {
  "stop-requested": { meaning: "a stop was asked for", reaction: "R2 stop ramp, 1 cycle, Stopped", next: "start the run again when ready" },
  "force-limit": { meaning: "the force is beyond force_limit_n", reaction: "R1 freeze, 1 sample, Holding", next: "free the tool and zero the sensor as its data sheet says" },
  "sensor-lost": { meaning: "no new force sample for ten of the sensor's declared periods", reaction: "R2 stop ramp, 11 samples, Stopped", next: "check the sensor's supply and cable, then start the run again; `yieldwall info SENSOR` shows its error register" },
};
const F64 = (name, unit = "") => ({ name, unit, meaning: name, type: "float64" });
const U8 = (name, codes) => ({ name, unit: "", meaning: name, type: "uint8", ...(codes ? { codes } : {}) });
const NUMBERS = ["scene_time_s", "force_x_n", "force_y_n", "tool_x_m", "tool_y_m", "proxy_x_m", "proxy_y_m", "surface_x_m", "surface_y_m", "target_left_rad", "target_right_rad", "measured_left_rad", "measured_right_rad", "signed_distance_m"];
const FIELDS = [
  { name: "index", unit: "", meaning: "number of the cycle", type: "uint64" },
  { name: "sync_ns", unit: "ns", meaning: "planned moment of SYNC", type: "uint64" },
  ...NUMBERS.map((name) => F64(name)),
  ...["sync_woke_ns", "woke_ns", "stepped_ns", "sent_ns", "hold_counter"].map((name) => ({ name, unit: name.endsWith("_ns") ? "ns" : "cycles", meaning: name, type: "uint32" })),
  { name: "cause_devices", unit: "", meaning: "devices", type: "uint16", codes: { left: 1, right: 2, sensor: 4 } },
  U8("state", STATE), U8("left_state", DRIVE), U8("right_state", DRIVE), U8("motion", { rest: 0, run: 1, halt: 2 }),
  U8("cause", { "stop-requested": 0, "force-limit": 1, "sensor-lost": 2 }),
  ...["has_cause", "is_on_surface", "is_impact", "is_saturated"].map((name) => ({ ...U8(name), type: "bool" })),
];
const SIZES = { float64: 8, uint64: 8, uint32: 4, uint16: 2, uint8: 1, bool: 1 };
let end = 0;
for (const field of FIELDS) {
  field.offset = Math.ceil(end / SIZES[field.type]) * SIZES[field.type];
  end = field.offset + SIZES[field.type];
}
const STRIDE = Math.ceil(end / 8) * 8;

const BASES = [[-0.1, -0.45], [0.1, -0.45]], PROXIMAL = 0.3, DISTAL = 0.4, YIELD = 20, OTHER_YIELD = 12, RADIUS = 0.12, WALL = 0.16;
const circle = Array.from({ length: 120 }, (_, k) => [RADIUS * Math.cos((k * Math.PI) / 60), RADIUS * Math.sin((k * Math.PI) / 60)]);

function angle([x, y], k) {
  const [bx, by] = BASES[k], dx = x - bx, dy = y - by, reach = Math.hypot(dx, dy);
  const inner = Math.acos((PROXIMAL ** 2 + reach ** 2 - DISTAL ** 2) / (2 * PROXIMAL * reach));
  return Math.atan2(dy, dx) + (k === 0 ? inner : -inner);
}

/// A hand that goes round and pushes against a wall at y = WALL, which yields at 20 N to a viscous slide.
function* rig(seed) {
  let proxy = [0, 0.05], random = seed, wasOn = false;
  const noise = () => ((random = (random * 1103515245 + 12345) % 2147483648) / 1073741824 - 1);
  for (let index = 0; ; index += 1) {
    const time = index / 1000, scene = time - 1;
    const phase = Math.max(0, scene) * 1.1;
    const hand = [0.11 * Math.sin(phase), 0.06 + (0.13 + 0.02 * Math.sin(0.23 * phase)) * Math.sin(0.71 * phase)];
    let force = [600 * (hand[0] - proxy[0]), 600 * (hand[1] - proxy[1])];
    const isFault = scene > 0 && scene % 9 > 6 && scene % 9 < 6.6;
    if (scene > 0 && !isFault) {
      proxy[0] += force[0] * 5e-5;
      const touches = proxy[1] >= WALL - 1e-9 && force[1] > 0;
      if (touches) proxy[1] = force[1] > YIELD ? proxy[1] + (force[1] - YIELD) * 5e-5 : Math.max(proxy[1], WALL);
      else proxy[1] = proxy[1] < WALL ? Math.min(WALL, proxy[1] + force[1] * 5e-5) : proxy[1] + force[1] * 5e-5;
    }
    const lag = 0.0002 * Math.min(10, Math.hypot(...force)) ** 1.2;
    const tool = [proxy[0] + lag * Math.sin(7 * time), proxy[1] + lag * Math.cos(5 * time)];
    force = force.map((value) => value + 0.15 * noise());
    const isOn = Math.abs(proxy[1] - WALL) < 1e-9;
    const late = 1500 + 900 * Math.abs(noise()) + (index % 997 === 0 ? 45000 * Math.abs(noise()) : 0);
    const state = scene < 0 ? STATE.enabling : isFault ? STATE.holding : STATE.running;
    yield {
      index, sync_ns: Math.round(time * 1e9), scene_time_s: scene < 0 ? -Infinity : scene,
      force_x_n: index === 5000 ? NaN : force[0], force_y_n: force[1], tool_x_m: tool[0], tool_y_m: tool[1], proxy_x_m: proxy[0], proxy_y_m: proxy[1],
      surface_x_m: 0, surface_y_m: 0, signed_distance_m: WALL - proxy[1],
      target_left_rad: angle(proxy, 0), target_right_rad: angle(proxy, 1), measured_left_rad: angle(tool, 0), measured_right_rad: angle(tool, 1),
      sync_woke_ns: late, woke_ns: late * 1.2, stepped_ns: late * 1.2 + 9000, sent_ns: late * 1.3 + 21000, hold_counter: 0,
      state, left_state: scene < -0.5 ? 3 : 4, right_state: scene < -0.5 ? 3 : 4, motion: state === STATE.running ? 1 : state === STATE.holding ? 2 : 0,
      has_cause: isFault ? 1 : 0, cause: isFault ? 1 + (Math.floor(scene / 9) % 2) : 0, cause_devices: isFault ? 4 : 0,
      is_on_surface: isOn ? 1 : 0, is_impact: isOn && !wasOn ? 1 : 0, is_saturated: 0,
    };
    wasOn = isOn;
  }
}

function packet(records, lost = 0) {
  const bytes = Buffer.alloc(16 + records.length * STRIDE);
  bytes.writeUInt8(1, 0);
  bytes.writeUInt32LE(records.length, 4);
  bytes.writeBigUInt64LE(BigInt(lost), 8);
  records.forEach((record, k) => {
    for (const { name, type, offset } of FIELDS) {
      const at = 16 + k * STRIDE + offset, value = record[name];
      if (type === "float64") bytes.writeDoubleLE(value, at);
      else if (type === "uint64") bytes.writeBigUInt64LE(BigInt(value), at);
      else if (type === "uint32") bytes.writeUInt32LE(Math.round(value), at);
      else if (type === "uint16") bytes.writeUInt16LE(value, at);
      else bytes.writeUInt8(value, at);
    }
  });
  return bytes;
}

function take(source, count) {
  return Array.from({ length: count }, () => source.next().value);
}

const LAWS = [["plastic", "plastic wall"], ["elastic", "spring"], ["viscous", "viscous"], ["free", "none"]].map(([key, name]) => ({ key, name }));
const SETTINGS = [
  { key: "yield_n", name: "yield force R", unit: "N", least: 4, most: 60, step: 0.5, value: 20 },
  { key: "friction_n", name: "friction F", unit: "N", least: 0, most: 20, step: 0.5, value: 5 },
  { key: "mass_kg", name: "virtual mass M", unit: "kg", least: 0.5, most: 10, step: 0.1, value: 2 },
  { key: "hold_steps", name: "hold N_wait", unit: "cycles", least: 0, most: 200, step: 1, value: 0 },
  { key: "hand_stiffness_n_per_m", name: "stiffness of the hand", unit: "N/m", least: 50, most: 2000, step: 10, value: 400 },
];
const PLAY_WALL = 0.06, SPRING = 1500, DAMPING = 40;

/// A rig that takes orders: a mass against the wall y = PLAY_WALL, whose forbidden side lies above.
class PlayedRig {
  constructor() {
    this.values = Object.fromEntries(SETTINGS.map(({ key, value }) => [key, value]));
    this.law = "plastic";
    this.position = [0, 0];
    this.aim = null;
    this.orders = [];
    this.boot();
  }

  /// Begins a new run with the tool at its place.
  boot() {
    Object.assign(this, { index: 0, velocity: [0, 0], state: STATE.enabling, cause: -1, smooth: this.aim && [...this.aim], wasOn: false });
  }

  get settings() { return SETTINGS.map((setting) => ({ ...setting, value: this.values[setting.key] })); }

  /// Takes an order; returns what to send: a new first message, a notice.
  take(order) {
    this.orders.push(order);
    if (order === "let_go") this.aim = null;
    else if (order === "stop") this.state = STATE.stopped;
    else if (order === "reset") [this.state, this.cause] = [STATE.idle, -1];
    else if (order === "enable") this.state = STATE.enabling;
    else if (order.hold) {
      this.aim = order.hold;
      this.smooth ??= [...this.position];
    } else if (order.fault) [this.state, this.cause] = [STATE.stopped, 2];
    else if (order.law) {
      this.law = order.law;
      this.boot();
      return { hello: true };
    } else if (order.set) {
      const { key, value } = order.set, wanted = { ...this.values, [key]: value };
      if (wanted.friction_n >= wanted.yield_n) return { hello: true, notice: `friction F (${wanted.friction_n} N) must be below the yield force R (${wanted.yield_n} N)` };
      this.values = wanted;
      if (key !== "hand_stiffness_n_per_m") this.boot();
      return { hello: true };
    } else throw new Error("an order that nobody knows");
    if (!this.aim) this.smooth = null;
    return {};
  }

  next() {
    const { values, position, velocity } = this, { yield_n: most, friction_n: friction, mass_kg: mass, hand_stiffness_n_per_m: stiffness } = values, T = 0.001;
    if (this.state === STATE.enabling && this.index > 50) this.state = STATE.running;
    if (this.smooth && this.aim) this.smooth = this.smooth.map((value, k) => value + (this.aim[k] - value) * 0.05);
    const force = this.smooth ? this.smooth.map((value, k) => stiffness * (value - position[k])) : [0, 0];
    let isOn = false;
    if (this.state !== STATE.running) velocity.fill(0);
    else {
      const depth = position[1] - PLAY_WALL;
      const push = [...force];
      if (this.law === "elastic" && depth > 0) push[1] -= SPRING * depth + DAMPING * velocity[1];
      if (this.law === "viscous" && depth > 0) push[1] -= 200 * velocity[1];
      const free = velocity.map((value, k) => value + (push[k] * T) / mass), speed = Math.hypot(...free), slow = (friction * T) / mass;
      const moving = speed > slow ? free.map((value) => value * (1 - slow / speed)) : [0, 0];
      // The hand's own damping.
      if (this.smooth) moving.forEach((value, k) => { moving[k] = value * (1 - (12 * T) / mass); });
      let next = position[1] + moving[1] * T;
      const stands = this.law === "plastic" && depth <= 1e-9 && next > PLAY_WALL - 1e-9;
      if (stands && force[1] <= most) [next, moving[1], isOn] = [PLAY_WALL, 0, true];
      else if (this.law === "plastic" && moving[1] > 0 && next > PLAY_WALL) {
        // Beyond the wall every way further in costs R.
        moving[1] = Math.max(0, velocity[1] + ((force[1] - most) * T) / mass);
        next = Math.max(position[1], PLAY_WALL - 1e-9) + moving[1] * T;
      }
      this.velocity = moving;
      this.position = [position[0] + moving[0] * T, next];
      // The edge of the workspace stops the tool.
      this.position.forEach((value, k) => {
        if (Math.abs(value) <= 0.15) return;
        this.position[k] = 0.15 * Math.sign(value);
        moving[k] = 0;
      });
    }
    const time = this.index * T, isImpact = isOn && !this.wasOn, tool = this.position;
    this.wasOn = isOn;
    this.index += 1;
    return {
      index: this.index - 1, sync_ns: Math.round(time * 1e9), scene_time_s: time, force_x_n: force[0], force_y_n: force[1],
      tool_x_m: tool[0], tool_y_m: tool[1], proxy_x_m: tool[0], proxy_y_m: tool[1], surface_x_m: 0, surface_y_m: 0, signed_distance_m: PLAY_WALL - tool[1],
      target_left_rad: angle(tool, 0), target_right_rad: angle(tool, 1), measured_left_rad: angle(tool, 0), measured_right_rad: angle(tool, 1),
      sync_woke_ns: 1500, woke_ns: 1800, stepped_ns: 11000, sent_ns: 23000, hold_counter: 0,
      state: this.state, left_state: 4, right_state: 4, motion: this.state === STATE.running ? 1 : 0,
      has_cause: this.cause >= 0 ? 1 : 0, cause: Math.max(0, this.cause), cause_devices: this.cause >= 0 ? 4 : 0,
      is_on_surface: isOn ? 1 : 0, is_impact: isImpact ? 1 : 0, is_saturated: 0,
    };
  }

  hello() {
    const whole = machine(0), isPlastic = this.law === "plastic";
    return {
      ...whole, name: "play", surfaces: [{ points_m: [[-0.3, PLAY_WALL], [0.3, PLAY_WALL]], is_closed: false, forbidden: "left" }],
      fixture: { law: this.law, yield_force_n: isPlastic ? this.values.yield_n : null, rows: this.settings.map(({ name, value, unit }) => [name, `${value} ${unit}`]) },
      command: "play", play: { settings: this.settings, laws: LAWS, law: this.law, faults: Object.entries(FAULTS).map(([name, { meaning }]) => ({ name, meaning })) },
    };
  }
}

/// What the page shows of a rig: the second one differs by its name, its yield force and its guide.
function machine(k) {
  const yield_n = [YIELD, OTHER_YIELD][k];
  return {
    name: ["paper-admittance", "paper-soft"][k], period_s: 0.001,
    arm: { bases_m: BASES, proximal_m: [PROXIMAL, PROXIMAL], distal_m: [DISTAL, DISTAL], singularity_margin_m: 0.02, tool: { fixed_to: "left", along_m: 0, across_m: 0 } },
    surfaces: [{ points_m: [[-0.3, WALL], [0.3, WALL]], is_closed: false, forbidden: "left" }, { points_m: circle.map(([x, y]) => [x * (1 - 0.3 * k), y * (1 - 0.3 * k)]), is_closed: true, forbidden: "none" }],
    view_m: [-0.42, -0.52, 0.42, 0.27],
    fixture: { law: "plastic", yield_force_n: yield_n, rows: [["Yield force R", `${yield_n} N`], ["Friction F", "3 N"], ["Virtual mass M", "2 kg"], ["Hold N_wait", "0 cycles"], ["Side", "unilateral"]] },
  };
}

/// Starts the server. `recorded` is the number of records of the first recording; without it the rig is live. The second
/// recording is half as long, the third is empty. `isPlayed` makes a rig that takes orders.
export async function serve(packages, { recorded = 0, csv = null, isPlayed = false } = {}) {
  const { WebSocketServer } = createRequire(join(packages, "package.json"))("ws");
  const recordings = recorded > 0 ? [[1, recorded], [77, recorded >> 1], [1, 0]].map(([seed, count]) => take(rig(seed), count)) : [];
  if (recordings[1]) for (const record of recordings[1]) for (const name of ["tool_x_m", "proxy_x_m"]) record[name] = record[name] * 0.9 - 0.004;
  if (csv) {
    const names = FIELDS.map(({ name }) => name);
    const row = (record) => names.map((name) => record[name]).join(",");
    writeFileSync(csv, `${[names.join(","), ...recordings[0].map(row)].join("\n")}\n`);
  }
  const hello = {
    kind: "hello", protocol: 1, program: "yieldwall 0.1.0", command: recorded ? "view" : "sim", is_live: recorded === 0, tier: null,
    record: { bytes: STRIDE, fields: FIELDS },
    ...machine(0),
    play: null,
    faults: FAULTS,
    recordings: recordings.map((records, k) => ({ name: `cycles-${k}.mcap`, records: records.length, machine: machine(k === 1 ? 1 : 0) })),
  };
  const server = createServer((request, response) => {
    const path = request.url === "/" ? "/index.html" : request.url;
    const isAllowed = request.headers.authorization === `Bearer ${TOKEN}`;
    const end = (status, type, body) => response.writeHead(status, { ...HEADERS, "Content-Type": type }).end(body);
    if (FILES.includes(path)) return end(200, TYPES[extname(path)], readFileSync(join(PAGE, path)));
    if (!isAllowed) return end(401, "text/plain", "");
    if (path === "/metrics") return end(200, "text/plain", "");
    const records = recordings[Number(path.match(/^\/recordings\/(\d)$/)?.[1])];
    if (!records) return end(404, "text/plain", "");
    const packets = [];
    for (let k = 0; k < records.length; k += 500) packets.push(packet(records.slice(k, k + 500)));
    return end(200, "application/octet-stream", Buffer.concat(packets));
  });
  const sockets = new WebSocketServer({ noServer: true, handleProtocols: () => "yieldwall.v1" });
  server.on("upgrade", (request, socket, head) => {
    if (!(request.headers["sec-websocket-protocol"] ?? "").includes(`token.${TOKEN}`)) return socket.end("HTTP/1.1 401 Unauthorized\r\n\r\n");
    return sockets.handleUpgrade(request, socket, head, (client) => {
      const greet = (to) => to.send(JSON.stringify({ ...hello, ...played?.hello() }));
      greet(client);
      client.on("message", (data, isBinary) => {
        try {
          if (!played || isBinary) throw new Error("no orders here");
          const answer = played.take(JSON.parse(data));
          for (const other of sockets.clients) {
            if (answer.notice) other.send(JSON.stringify({ kind: "notice", message: answer.notice }));
            if (answer.hello) greet(other);
          }
          if (answer.hello) [begin, sent] = [Date.now(), 0];
        } catch {
          client.close(1003);
        }
      });
      client.on("close", () => played?.take("let_go"));
      if (recorded > 0) return;
      const status = setInterval(() => client.send(JSON.stringify({ kind: "status", buses: [{ name: "can0", load_percent: 61.4 }], clients: 1, refused: 0, lost: 0 })), 1000);
      client.on("close", () => clearInterval(status));
    });
  });
  // The rig runs on without a client, as a real one does.
  const played = isPlayed ? new PlayedRig() : null;
  const source = played ? { next: () => ({ value: played.next() }) } : rig(1);
  let begin = Date.now(), sent = 0;
  const timer = recorded > 0 ? null : setInterval(() => {
    for (const due = Date.now() - begin; sent + 16 <= due; sent += 16) {
      const bytes = packet(take(source, 16));
      for (const client of sockets.clients) if (client.readyState === client.OPEN) client.send(bytes);
    }
  }, 4);
  const drop = () => { for (const client of sockets.clients) client.terminate(); };
  await new Promise((done) => server.listen(0, "127.0.0.1", done));
  return { address: `http://127.0.0.1:${server.address().port}/#${TOKEN}`, recordings, played, drop, close: () => { clearInterval(timer); drop(); server.closeAllConnections(); server.close(); } };
}
