// Records as the program sends them: packets of fixed-size records, kept as bytes, with the derived columns of the traces.

const READERS = {
  float64: (view, at) => view.getFloat64(at, true),
  uint64: (view, at) => Number(view.getBigUint64(at, true)),
  uint32: (view, at) => view.getUint32(at, true),
  int32: (view, at) => view.getInt32(at, true),
  uint16: (view, at) => view.getUint16(at, true),
  uint8: (view, at) => view.getUint8(at),
  bool: (view, at) => view.getUint8(at),
};

const COLUMNS = ["time", "force", "power", "energy", "left", "right", "distance"];
const PACKET_HEAD = 16;
/// Steps over which the velocity of the displayed power is averaged, as in the program's figures.
const VELOCITY_STEPS = 5;
const LARGEST_EVENTS = 5000;
const LARGEST_PATH = 20000;

export const STAGES = [
  ["sync_woke_ns", "woke for SYNC"],
  ["woke_ns", "woke for computation"],
  ["stepped_ns", "step computed"],
  ["sent_ns", "set-points sent"],
];
/// Bins of a stage: 12 a decade from 1 us, so that 60 of them reach 100 ms.
export const BINS = 60;
export const BINS_PER_DECADE = 12;

export class Records {
  static DERIVED_BYTES = COLUMNS.length * 8;

  /// `layout` describes the fields and `machine` the rig that made the records: name, period_s, arm, surfaces, view_m,
  /// fixture. `capacity` records are kept; a further one replaces the oldest.
  constructor(layout, machine, capacity) {
    this.machine = machine;
    this.capacity = Math.max(2, Math.floor(capacity));
    this.stride = layout.bytes;
    this.period_s = machine.period_s > 0 ? machine.period_s : 0.001;
    this.serverLost = 0;
    this.fields = new Map(layout.fields.map((field) => [field.name, field]));
    this.names = new Map();
    for (const field of layout.fields) {
      if (field.codes) this.names.set(field.name, new Map(Object.entries(field.codes).map(([name, code]) => [Number(code), name])));
    }
    this.bytes = new Uint8Array(this.capacity * this.stride);
    this.view = new DataView(this.bytes.buffer);
    this.columns = Object.fromEntries(COLUMNS.map((name) => [name, new Float64Array(this.capacity)]));
    // An impedance device has no arm. Its records hold the handle's position and the actuators' force on the hand.
    this.isDevice = this.has("reported_x_m");
    /// Sign of the force that does work on the tool or the handle, against the recorded force.
    this.workSign = this.isDevice ? -1 : 1;
    this.words = this.isDevice ? { tool: "handle", force: "force on the hand" } : { tool: "tool", force: "force of the hand" };
    const reader = (name) => this.reader(name);
    this.get = {
      index: reader("index"),
      clock: reader("sync_ns") ?? reader("sample_ns"),
      scene: reader("scene_time_s"),
      toolX: reader("tool_x_m") ?? reader("reported_x_m"),
      toolY: reader("tool_y_m") ?? reader("reported_y_m"),
      toolZ: reader("reported_z_m"),
      proxyX: reader("proxy_x_m"),
      proxyY: reader("proxy_y_m"),
      proxyZ: reader("proxy_z_m"),
      forceX: reader("force_x_n"),
      forceY: reader("force_y_n"),
      forceZ: reader("force_z_n"),
      targetLeft: reader("target_left_rad"),
      targetRight: reader("target_right_rad"),
      measuredLeft: reader("measured_left_rad"),
      measuredRight: reader("measured_right_rad"),
      isImpact: reader("is_impact"),
      hasCause: reader("has_cause"),
      cause: reader("cause"),
      stages: STAGES.map(([name]) => reader(name)),
    };
    /// Runs that have begun after the first one.
    this.runs = 0;
    this.forget();
  }

  /// Forgets all records.
  forget() {
    this.total = 0;
    this.sceneStart = NaN;
    this.faults = [];
    this.impacts = [];
    this.lastCause = -1;
    this.lastImpact = false;
    this.path = [];
    this.pathStep = pathStep(this.machine.view_m);
    this.bins = STAGES.map(() => new Uint32Array(BINS));
    this.worst = STAGES.map(() => 0);
  }

  get first() { return Math.max(0, this.total - this.capacity); }
  get last() { return this.total - 1; }
  has(name) { return this.fields.has(name); }

  /// Returns a function from a record's byte offset to the field's value, or null without that field.
  reader(name) {
    const field = this.fields.get(name);
    const read = field && READERS[field.type];
    return read ? (at) => read(this.view, at + field.offset) : null;
  }

  /// Value of a field of a record; NaN without that field or record.
  value(name, index) {
    const read = this.reader(name);
    return read && this.holds(index) ? read(this.place(index)) : NaN;
  }

  /// Name of a coded value; null without that field.
  code(name, index) {
    const value = this.value(name, index);
    return Number.isNaN(value) ? null : (this.names.get(name)?.get(value) ?? String(value));
  }

  /// Names of the bits of a coded set.
  set(name, index) {
    const bits = this.value(name, index);
    return [...(this.names.get(name) ?? [])].filter(([bit]) => (bits & bit) !== 0).map(([, device]) => device.replaceAll("-", " "));
  }

  holds(index) { return index >= this.first && index <= this.last; }
  place(index) { return (index % this.capacity) * this.stride; }
  /// Value of a derived column of a record; NaN without that record.
  column(name, index) { return this.holds(index) ? this.columns[name][index % this.capacity] : NaN; }
  time(index) { return this.column("time", index); }

  /// Last record at or before a time, within the records that are kept.
  at(time) {
    let low = this.first, high = this.last;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.columns.time[middle % this.capacity] <= time) low = middle; else high = middle - 1;
    }
    return low;
  }

  /// Takes whole packets from `bytes`; returns how many bytes it took. `stopsWhenFull` ends at the capacity. Otherwise a
  /// record with a lower index than the last one begins another run, and the earlier records are forgotten.
  take(bytes, stopsWhenFull = false) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    let at = 0;
    while (bytes.length - at >= PACKET_HEAD) {
      if (view.getUint8(at) !== 1) throw new Error("a packet begins with an unknown kind");
      const count = view.getUint32(at + 4, true);
      const end = at + PACKET_HEAD + count * this.stride;
      if (end > bytes.length) break;
      this.serverLost = Number(view.getBigUint64(at + 8, true));
      for (let from = at + PACKET_HEAD; from < end; from += this.stride) {
        if (stopsWhenFull && this.total === this.capacity) return bytes.length;
        if (!stopsWhenFull && this.isEarlier(view, from)) {
          this.runs += 1;
          this.forget();
        }
        this.append(bytes, from);
      }
      at = end;
    }
    return at;
  }

  /// Whether the record at a byte of a packet has a lower index than the last one here.
  isEarlier(view, from) {
    if (this.total === 0 || !this.has("index")) return false;
    const { type, offset } = this.fields.get("index");
    return READERS[type](view, from + offset) < this.get.index(this.place(this.last));
  }

  /// Number of records that are missing between the last one and a packet of the same run.
  /// `elapsed_s` is the wall-clock time between the two. NaN: the packet belongs to another run.
  missedBefore(bytes, elapsed_s) {
    if (this.total === 0) return 0;
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength), last = this.place(this.last);
    const difference = (name) => {
      const { type, offset } = this.fields.get(name);
      return READERS[type](view, PACKET_HEAD + offset) - READERS[type](this.view, last + offset);
    };
    const clock = ["sync_ns", "sample_ns"].find((name) => this.has(name));
    let steps = NaN;
    if (this.has("index")) steps = difference("index");
    else if (clock) steps = Math.round((difference(clock) * 1e-9) / this.period_s);
    const isSameRun = steps >= 1 && Math.abs(steps * this.period_s - elapsed_s) < 2 + 0.1 * elapsed_s;
    return isSameRun ? steps - 1 : NaN;
  }

  append(bytes, from) {
    const index = this.total, slot = index % this.capacity, at = slot * this.stride;
    this.bytes.set(bytes.subarray(from, from + this.stride), at);
    this.total = index + 1;
    const { columns, get } = this;
    const before = index > this.first ? (index - 1) % this.capacity : -1;

    let time = get.clock ? get.clock(at) * 1e-9 : index * this.period_s;
    if (before >= 0 && !(time > columns.time[before])) time = columns.time[before] + this.period_s;
    columns.time[slot] = time;
    if (Number.isNaN(this.sceneStart) && get.scene) {
      const scene = get.scene(at);
      if (Number.isFinite(scene)) this.sceneStart = time - scene;
    }

    const fx = read(get.forceX, at), fy = read(get.forceY, at), fz = get.forceZ ? get.forceZ(at) : 0;
    columns.force[slot] = Math.hypot(fx, fy, fz);
    columns.energy[slot] = before >= 0 ? finiteOr(columns.energy[before], 0) + finiteOr(this.work(index - 1, at, fx, fy, fz), 0) : 0;
    columns.power[slot] = this.power(index, at, fx, fy, fz);
    columns.left[slot] = read(get.targetLeft, at) - read(get.measuredLeft, at);
    columns.right[slot] = read(get.targetRight, at) - read(get.measuredRight, at);
    const px = read(get.proxyX, at), py = read(get.proxyY, at);
    const dz = get.toolZ && get.proxyZ ? get.proxyZ(at) - get.toolZ(at) : 0;
    columns.distance[slot] = Math.hypot(px - read(get.toolX, at), py - read(get.toolY, at), dz);

    this.note(index, at);
    const tail = this.path[this.path.length - 1];
    if (Number.isFinite(px) && Number.isFinite(py) && (!tail || Math.hypot(px - tail.x, py - tail.y) > this.pathStep)) {
      this.path.push({ index, x: px, y: py });
      if (this.path.length > LARGEST_PATH) this.thin();
    }
  }

  /// Drops the path's points of records that are gone, and every second one if that is not enough.
  thin() {
    this.path = this.path.filter((point) => point.index >= this.first);
    if (this.path.length < LARGEST_PATH / 2) return;
    this.path = this.path.filter((_, k) => k % 2 === 0);
    this.pathStep *= 2;
  }

  /// Work of the hand on the tool or the handle from record `before` to the one at byte `at`, by the trapezoidal rule.
  work(before, at, fx, fy, fz) {
    const { get } = this, from = this.place(before);
    const mean = (axis, now) => (now + read(axis, from)) / 2;
    const z = get.toolZ && get.forceZ ? mean(get.forceZ, fz) * (get.toolZ(at) - get.toolZ(from)) : 0;
    return this.workSign * (mean(get.forceX, fx) * (read(get.toolX, at) - read(get.toolX, from))
      + mean(get.forceY, fy) * (read(get.toolY, at) - read(get.toolY, from)) + z);
  }

  power(index, at, fx, fy, fz) {
    const { get } = this, earlier = Math.max(this.first, index - VELOCITY_STEPS);
    if (earlier === index) return 0;
    const from = this.place(earlier), lasted = this.time(index) - this.time(earlier);
    const z = get.toolZ ? fz * (get.toolZ(at) - get.toolZ(from)) : 0;
    return this.workSign * (fx * (read(get.toolX, at) - read(get.toolX, from)) + fy * (read(get.toolY, at) - read(get.toolY, from)) + z) / lasted;
  }

  /// Notes faults, impacts and stage times of a record.
  note(index, at) {
    const { get } = this;
    const cause = get.hasCause && get.hasCause(at) ? read(get.cause, at) : -1;
    if (cause !== this.lastCause && cause >= 0) bounded(this.faults, index);
    this.lastCause = cause;
    const isImpact = Boolean(get.isImpact && get.isImpact(at));
    if (isImpact && !this.lastImpact) bounded(this.impacts, index);
    this.lastImpact = isImpact;
    get.stages.forEach((stage, k) => {
      if (!stage) return;
      const ns = stage(at);
      if (ns > this.worst[k]) this.worst[k] = ns;
      this.bins[k][binOf(ns)] += 1;
    });
  }
}

const read = (reader, at) => (reader ? reader(at) : NaN);
const finiteOr = (value, other) => (Number.isFinite(value) ? value : other);

function binOf(ns) {
  const bin = Math.floor(Math.log10(Math.max(ns, 1) / 1000) * BINS_PER_DECADE);
  return Math.min(Math.max(bin, 0), BINS - 1);
}

/// Upper edge in us of the bin that holds the given share of all counts.
export function quantile_us(bins, share) {
  const all = bins.reduce((sum, count) => sum + count, 0);
  let sum = 0;
  for (let bin = 0; bin < BINS; bin += 1) {
    sum += bins[bin];
    if (all > 0 && sum >= share * all) return 10 ** ((bin + 1) / BINS_PER_DECADE);
  }
  return NaN;
}

function bounded(list, index) {
  list.push(index);
  if (list.length > LARGEST_EVENTS) list.splice(0, LARGEST_EVENTS / 4);
}

function pathStep(view) {
  const size = view ? Math.hypot(view[2] - view[0], view[3] - view[1]) : 1;
  return Number.isFinite(size) && size > 0 ? size / 1000 : 1e-3;
}

/// Lowest and highest value of columns in buckets of time, as uPlot takes them: two points a bucket.
export function envelope(low, high, width, series) {
  const buckets = Math.max(2, Math.min(width, 2000));
  const step = (high - low) / buckets;
  const start = Math.floor(low / step);
  const times = [], data = [times, ...series.map(() => [])];
  for (let k = 0; k <= buckets; k += 1) times.push((start + k) * step, (start + k + 0.5) * step);
  series.forEach(({ records, column, scale, offset }, which) => {
    const out = data[which + 1], values = records.columns[column], clock = records.columns.time, { capacity } = records;
    const from = start * step + offset;
    let index = records.total === 0 ? 1 : records.at(from);
    const last = records.last;
    if (records.total > 0 && clock[index % capacity] < from) index += 1;
    let earlier = null;
    for (let k = 0; k <= buckets; k += 1) {
      const end = (start + k + 1) * step + offset;
      let least = Infinity, most = -Infinity, isRising = true, count = 0;
      for (; index <= last && clock[index % capacity] < end; index += 1) {
        const value = values[index % capacity];
        count += 1;
        if (!Number.isFinite(value)) continue;
        if (value < least) { least = value; isRising = false; }
        if (value > most) { most = value; isRising = true; }
      }
      if (least <= most) {
        const pair = isRising ? [least, most] : [most, least];
        out.push(pair[0] * scale, pair[1] * scale);
        earlier = pair[1];
      } else if (count === 0 && earlier !== null && index <= last && step < 4 * records.period_s) {
        out.push(undefined, undefined);
      } else {
        out.push(null, null);
        earlier = null;
      }
    }
  });
  return data;
}
