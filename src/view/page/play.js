// Play: the pointer as a hand on the simulated tool, the settings of the wall, and a guide of three minutes.

const STEP_M = 0.002, LARGE_STEP_M = 0.01;
const NOTICE_MS = 12000;
/// A control takes the program's value this long after its last change, so that an answer to an earlier change cannot move it.
const SETTLE_MS = 400;
/// States of the supervisor in which an order has an effect. The program resets a stopped rig before it enables it.
const USABLE_IN = { stop: ["enabling", "running", "holding"], reset: ["stopped", "disabled", "lost"], enable: ["idle", "stopped", "disabled", "lost"] };
const ALARMS = ["holding", "stopping", "stopped", "disabled", "lost"];
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

const $ = (id) => document.getElementById(id);
const make = (tag, className = "", text = "") => Object.assign(document.createElement(tag), { className, textContent: text });
function write(element, text) { if (element.textContent !== text) element.textContent = text; }

/// The hand: aims at a point of the scene, in m, by pointer or by keys.
class Hand {
  aim = null;
  isHeld = false;
  isOn = false;
  pointer = null;

  constructor(canvas, hooks) {
    Object.assign(this, { canvas, hooks });
    const on = (target, kinds, act) => kinds.split(" ").forEach((kind) => target.addEventListener(kind, act));
    on(canvas, "pointerdown", (event) => this.pressed(event));
    on(canvas, "pointermove", (event) => { if (event.pointerId === this.pointer) this.moveTo(this.point(event)); });
    on(canvas, "pointerup pointercancel lostpointercapture", (event) => { if (event.pointerId === this.pointer) this.letGo(); });
    on(canvas, "contextmenu", (event) => { if (this.isOn) event.preventDefault(); });
    on(canvas, "keydown", (event) => this.key(event));
    on(canvas, "blur", () => { if (this.pointer === null) this.letGo(); });
    on(window, "blur pagehide", () => this.letGo());
    on(document, "visibilitychange", () => { if (document.hidden) this.letGo(); });
  }

  point({ clientX, clientY }) {
    const { left, top } = this.canvas.getBoundingClientRect();
    return this.hooks.place().from(clientX - left, clientY - top);
  }

  pressed(event) {
    if (!this.isOn || event.button !== 0 || this.pointer !== null) return;
    this.pointer = event.pointerId;
    this.canvas.setPointerCapture(event.pointerId);
    this.hold(this.point(event));
  }

  hold(aim) {
    this.hooks.live();
    this.isHeld = true;
    this.aim = aim;
    this.hooks.send({ hold: aim });
    this.hooks.changed();
  }

  /// Sends the aim at most once an animation frame.
  moveTo(aim) {
    this.aim = aim;
    this.hooks.changed();
    if (this.isHeld) this.frame ??= requestAnimationFrame(() => {
      this.frame = null;
      if (this.isHeld) this.hooks.send({ hold: this.aim });
    });
  }

  letGo() {
    if (this.isHeld) this.hooks.send("let_go");
    this.forget();
  }

  /// Ends the hold without a message.
  forget() {
    this.isHeld = false;
    this.aim = null;
    this.pointer = null;
    this.hooks.changed();
  }

  key(event) {
    if (!this.isOn || event.ctrlKey || event.metaKey || event.altKey) return;
    const { key } = event, arrow = ARROWS[key], from = this.aim ?? this.hooks.tool();
    if (!(arrow || key === " " || key === "Escape")) return;
    event.preventDefault();
    event.stopPropagation();
    if (key === "Escape" || (key === " " && this.isHeld)) {
      if (!event.repeat) this.letGo();
    } else if (from?.every(Number.isFinite)) {
      const step = event.shiftKey ? LARGE_STEP_M : STEP_M;
      if (arrow) this.moveTo(from.map((value, k) => value + arrow[k] * step));
      else if (!event.repeat) this.hold(from);
    }
  }
}

const STAYS_M = 0.003, PASSED_M = 0.005, PRESSED_M = 0.001;
/// Records between two places from which the guide takes a speed.
const SPEED_STEPS = 10;

/// Six steps to try, each of which the records show to be done.
class Guide {
  constructor() { this.restart(); }

  restart() {
    this.step = 0;
    this.results = {};
    this.forget();
  }

  /// Forgets what it knows of the run.
  forget() {
    Object.assign(this, { next: 0, since: null, okay: -Infinity, strong: null, release: null, anchor: null, isTouching: false, start_j: 0, peak_j: 0, drop_j: 0 });
    if (this.step === 2 || this.step === 5) this.step -= 1;
  }

  /// Looks at the records that are new. `now`: law, yield_n, mass_kg, isHeld.
  take(records, now) {
    if (records !== this.records || records.runs !== this.runs || records.total < this.next) this.forget();
    Object.assign(this, { records, runs: records.runs });
    for (this.next = Math.max(this.next, records.first); this.next <= records.last; this.next += 1) this.see(records, this.next, now);
  }

  see(records, index, now) {
    const { get } = records, at = records.place(index), force = records.column("force", index), energy = records.column("energy", index), time = records.time(index);
    const x = get.toolX?.(at), y = get.toolY?.(at), distance = records.value("signed_distance_m", index), isOn = records.value("is_on_surface", index) === 1;
    if (![force, x, y, distance].every(Number.isFinite)) return;
    const { yield_n: most } = now;
    // A wall with a forbidden side has its free side where the distance is positive. Any other has it where the tool came from.
    if ((records.machine.surfaces ?? []).some(({ forbidden }) => forbidden !== "none")) this.side = 1;
    else if (Math.abs(distance) > PRESSED_M && (this.step === 0 ? !isOn : this.step === 3 && !(force > 0.2 * most))) this.side = Math.sign(distance);
    const depth = -(this.side ?? 1) * distance, isTouching = isOn || depth > (this.isTouching ? -0.5 * PRESSED_M : 0);
    if (isTouching && !this.isTouching) Object.assign(this, { start_j: energy, peak_j: energy, drop_j: 0 });
    this.isTouching = isTouching;
    this.isBehind = depth > PASSED_M;
    this.peak_j = Math.max(this.peak_j, energy);
    this.drop_j = Math.max(this.drop_j, this.peak_j - energy);

    // Once the hand is gone: way and greatest speed outwards from the last place where it pressed.
    if (now.isHeld || force > 0.3 * most) {
      this.strong = { x, y, depth, time, energy, index };
      this.release = null;
    } else if (force < 0.1 * most && this.strong && !this.release) {
      this.release = { ...this.strong, given_j: this.strong.energy - this.start_j, drop_j: 0, moved_m: 0, back_m: 0, fastest_m_per_s: 0 };
      this.anchor = { x, y, time };
    }
    const { release } = this;
    if (release) {
      release.moved_m = Math.max(release.moved_m, Math.hypot(x - release.x, y - release.y));
      release.drop_j = Math.max(release.drop_j, this.drop_j);
      release.back_m = Math.max(release.back_m, release.depth - depth);
      const before = index - SPEED_STEPS;
      if (before >= release.index && records.holds(before)) {
        const speed = (-(this.side ?? 1) * records.value("signed_distance_m", before) - depth) / (time - records.time(before));
        release.fastest_m_per_s = Math.max(release.fastest_m_per_s, speed);
      }
      if (Math.hypot(x - this.anchor.x, y - this.anchor.y) > STAYS_M) this.anchor = { x, y, time };
    }
    const hasStayed = (span_s) => release && time - this.anchor.time >= span_s;

    const isPlastic = now.law === "plastic", isSpring = now.law === "elastic";
    if (this.step > 3 && this.step < 6 && !isSpring) this.step = 3;
    if (this.step === 0) {
      // An impact may leave the proxy some tenths of a millimetre behind the surface.
      const isGentle = isPlastic && isTouching && !this.isBehind && force > 0.2 * most && force < most;
      if (isGentle) [this.since, this.okay] = [this.since ?? time, time];
      else if (force >= most || time - this.okay > 0.1) this.since = null;
      if (this.since !== null && time - this.since >= 1) this.step = 1;
    } else if (this.step === 1) {
      if (isPlastic && depth > PASSED_M && force > 0.3 * most) this.step = 2;
    } else if (this.step === 2) {
      if (hasStayed(1)) this.finish("plastic", now);
    } else if (this.step === 3) {
      if (isSpring && depth > PRESSED_M && force > 0.2 * most) this.step = 4;
    } else if (this.step === 4) {
      if (isSpring && depth > PRESSED_M && force > 0.8 * most) this.step = 5;
    } else if (this.step === 5 && (hasStayed(0.5) || (release && time - release.time > 3))) {
      // A hand that went back by itself left nothing to throw.
      if (release.depth > PRESSED_M) this.finish("elastic", now); else [this.step, this.strong, this.release] = [4, null, null];
    }
  }

  finish(law, { mass_kg }) {
    const { release } = this;
    const motion_j = (mass_kg * release.fastest_m_per_s ** 2) / 2;
    this.results[law] = {
      moved_mm: release.moved_m * 1000, back_mm: release.back_m * 1000, fastest_mm_per_s: release.fastest_m_per_s * 1000,
      given_mj: release.given_j * 1000, returned_mj: Number.isFinite(motion_j) ? (release.drop_j + motion_j) * 1000 : NaN,
    };
    this.step += 1;
    Object.assign(this, { strong: null, release: null });
  }
}

const newtons = (value) => `${Number(value.toPrecision(3))} N`;
const millis = (value, unit) => (Number.isFinite(value) ? `${value.toFixed(value < 9.95 ? 1 : 0)} ${unit}` : "unknown");

/// Texts of the steps: title and advice.
const STEPS = [
  ["Push gently", ({ yield_n }) => `Press on the picture: the hand pulls the tool to the pointer. Push the tool against the wall for a second, with the arrow inside the dashed circle. The wall is hard below R = ${newtons(yield_n)}.`],
  ["Push harder", ({ yield_n }) => `Move the pointer further, so that the arrow leaves the circle. Above ${newtons(yield_n)} the wall gives way.`],
  ["Let go", () => "Let go while the tool is behind the wall, and watch for a second."],
  ["Choose the spring", ({ names }) => `Pull the tool back to the free side. Choose "${names.elastic}", a common kind of virtual wall, and push against it.`],
  ["Push as hard", ({ yield_n }) => `Push with more than ${newtons(0.8 * yield_n)}. The spring stores the energy of your push.`],
  ["Let go again", () => "Let go while you push, and watch the tool."],
];

const CLOSING = "The spring stored the energy of your push and threw the tool back. The plastic wall gave way and stored nothing.";

/// The panel, the hand and the guide of a program that takes orders.
export class Play {
  isOn = false;
  isOpen = true;
  touched = new Map();

  /// `hooks`: send(order), place() gives the projection of the scene, tool() its newest place, live() follows the rig, changed() draws.
  constructor(canvas, hooks) {
    Object.assign(this, { canvas, hooks, hand: new Hand(canvas, hooks), guide: new Guide() });
    for (const order of Object.keys(USABLE_IN)) {
      $(order).addEventListener("click", () => { if ($(order).getAttribute("aria-disabled") !== "true") hooks.send(order); });
    }
    $("guide-restart").addEventListener("click", () => { this.guide.restart(); this.isOpen = true; this.guideTexts(); });
    $("guide-skip").addEventListener("click", () => { this.isOpen = false; this.guideTexts(); $("guide-restart").focus(); });
    $("notice-close").addEventListener("click", () => this.notice(""));
  }

  /// Takes the first message, or one that replaces it.
  begin({ play }) {
    this.isOn = Boolean(play);
    this.hand.isOn = this.isOn;
    document.body.classList.toggle("play", this.isOn);
    $("play-panel").hidden = !this.isOn;
    if (!this.isOn) {
      $("guide").hidden = true;
      return;
    }
    this.play = play;
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "application");
    this.canvas.setAttribute("aria-describedby", "hand-keys");
    this.draw(play);
    this.settle();
    if (this.hand.isHeld) this.hand.moveTo(this.hand.aim);
    this.texts();
  }

  /// Makes the controls, if the lists differ from the shown ones.
  draw({ laws, settings, faults }) {
    const shape = JSON.stringify([laws, settings.map(({ value, ...rest }) => rest), faults]);
    if (shape === this.shape) return;
    this.shape = shape;
    $("laws").replaceChildren(...laws.map(({ key, name }) => {
      const label = make("label"), input = Object.assign(make("input"), { type: "radio", name: "law", value: key });
      input.addEventListener("change", () => this.change("law", { law: key }));
      label.append(input, make("span", "", name));
      return label;
    }));
    $("settings").replaceChildren(...settings.map((setting) => this.slider(setting)));
    $("injections").replaceChildren(...faults.map(({ name, meaning }) => {
      const button = Object.assign(make("button", "", name), { type: "button", title: meaning });
      button.addEventListener("click", () => this.hooks.send({ fault: name }));
      for (const kind of ["focus", "pointerenter"]) button.addEventListener(kind, () => write($("injection-meaning"), `${name}: ${meaning}`));
      return button;
    }));
    $("injections-whole").hidden = faults.length === 0;
  }

  slider({ key, name, unit, least, most, step }) {
    const row = make("div", "setting"), label = Object.assign(make("label", "", name), { htmlFor: `set-${key}` });
    const input = Object.assign(make("input"), { type: "range", id: `set-${key}`, min: least, max: most, step });
    const output = make("output", "number");
    output.htmlFor.add(input.id);
    input.dataset.unit = unit;
    const send = () => this.change(key, { set: { key, value: Number(input.value) } });
    input.addEventListener("input", () => {
      this.touched.set(key, performance.now());
      valueText(input);
      // The hand alone changes without a new run.
      if (key === "hand_stiffness_n_per_m") send();
    });
    input.addEventListener("change", () => { if (key !== "hand_stiffness_n_per_m") send(); });
    row.append(label, output, input);
    return row;
  }

  change(key, order) {
    this.touched.set(key, performance.now());
    this.hooks.send(order);
    clearTimeout(this.settling);
    this.settling = setTimeout(() => this.settle(), SETTLE_MS + 10);
  }

  /// Shows the program's values on the controls that nobody has just changed.
  settle() {
    const isFree = (key) => !(performance.now() - this.touched.get(key) < SETTLE_MS);
    for (const { key, value } of this.play.settings) {
      const input = $(`set-${key}`);
      if (isFree(key)) input.value = String(value);
      valueText(input);
    }
    if (isFree("law")) for (const input of $("laws").querySelectorAll("input")) input.checked = input.value === this.play.law;
  }

  /// Value of a setting; NaN without it.
  value(key) { return this.play?.settings.find((setting) => setting.key === key)?.value ?? NaN; }

  /// Values of the hand for the drawing; null without play.
  drawn() {
    if (!this.isOn) return null;
    const yield_n = this.value("yield_n"), { aim, isHeld } = this.hand;
    const input = $("set-hand_stiffness_n_per_m"), stiffness = Number(input?.value ?? NaN);
    return { yield_n, reach_m: yield_n / stiffness, aim, isHeld };
  }

  take(records) {
    if (!this.isOn) return;
    this.guide.take(records, { law: this.play.law, yield_n: this.value("yield_n"), mass_kg: this.value("mass_kg"), isHeld: this.hand.isHeld });
  }

  notice(text) {
    clearTimeout(this.noticing);
    $("play-notice").classList.toggle("shown", text !== "");
    write($("play-notice-text"), text);
    $("notice-close").hidden = !text;
    if (text) this.noticing = setTimeout(() => this.notice(""), NOTICE_MS);
  }

  disconnected() {
    this.hand.forget();
    this.state = null;
    if (this.isOn) this.ordersFor(null);
  }

  /// Writes what changes from record to record.
  texts(records = null) {
    if (!this.isOn) return;
    if (records?.total > 0) {
      this.state = records.code("state", records.last);
      this.chips(records);
      this.ordersFor(this.state);
    }
    this.guideTexts();
  }

  chips(records) {
    const list = $("play-states"), names = [...(records.names.get("state") ?? [])].sort(([a], [b]) => a - b).map(([, name]) => name);
    if (list.dataset.names !== `${names}`) {
      list.dataset.names = `${names}`;
      list.replaceChildren(...names.map((name) => make("li", "", name)));
    }
    for (const item of list.children) {
      const isNow = item.textContent === this.state;
      item.className = isNow ? `now${ALARMS.includes(this.state) ? " alarm" : ""}` : "";
      if (isNow) item.setAttribute("aria-current", "true"); else item.removeAttribute("aria-current");
    }
  }

  ordersFor(state) {
    for (const [order, states] of Object.entries(USABLE_IN)) $(order).setAttribute("aria-disabled", String(!states.includes(state)));
  }

  guideTexts() {
    const { guide, play } = this, names = Object.fromEntries((play?.laws ?? []).map(({ key, name }) => [key, name]));
    $("guide").hidden = !(this.isOn && names.plastic && names.elastic);
    if ($("guide").hidden) return;
    const isDone = guide.step === STEPS.length, { isOpen } = this;
    $("guide-body").hidden = !isOpen;
    $("guide-skip").hidden = !isOpen;
    write($("guide-skip"), isDone ? "Close" : "Skip");
    write($("guide-restart"), isOpen ? "Start again" : "Start");
    const list = $("guide-steps");
    if (list.children.length === 0) list.append(...STEPS.map(([title]) => {
      const item = make("li");
      item.append(make("span", "", title));
      return item;
    }));
    [...list.children].forEach((item, k) => {
      item.className = k < guide.step ? "done" : k === guide.step ? "now" : "";
      if (k === guide.step) item.setAttribute("aria-current", "step"); else item.removeAttribute("aria-current");
    });
    const hint = isDone ? "" : this.hint(names), advice = isDone ? CLOSING : `${guide.step + 1}. ${STEPS[guide.step][1]({ yield_n: this.value("yield_n"), names })}`;
    write($("guide-text"), hint || advice);
    $("guide-text").classList.toggle("hint", hint !== "");
    this.resultTexts(names);
    $("guide-end").hidden = !isDone;
  }

  /// The reason why the present step cannot go on; empty without one.
  hint(names) {
    const { step, isBehind } = this.guide, { state, play } = this;
    if (USABLE_IN.enable.includes(state)) return `The rig is in the state "${state}". Press "Enable" to go on.`;
    if (state === "holding") return "The rig holds because of a fault. Let go, and it runs again after a moment.";
    if (step < 3 && play.law !== "plastic") return `Choose "${names.plastic}" for this step.`;
    if (step === 0 && isBehind) return "The tool broke through the wall: the push or the impact was above R. Pull it back to the free side and push slowly.";
    return "";
  }

  resultTexts(names) {
    const { results } = this.guide, body = $("guide-results").tBodies[0];
    $("guide-results").hidden = Object.keys(results).length === 0;
    for (const row of [...body.rows]) if (!results[row.dataset.law]) row.remove();
    for (const [law, result] of Object.entries(results)) {
      let row = [...body.rows].find(({ dataset }) => dataset.law === law);
      if (!row) {
        row = body.insertRow();
        row.dataset.law = law;
        row.append(Object.assign(make("th"), { scope: "row" }), ...["", "", "", ""].map(() => make("td")));
      }
      for (const [key, value] of Object.entries(result)) row.dataset[key] = value.toFixed(2);
      const way = law === "plastic" ? result.moved_mm : result.back_mm;
      [names[law], millis(way, "mm"), millis(Math.max(0, result.fastest_mm_per_s), "mm/s"), millis(result.given_mj, "mJ"), millis(result.returned_mj, "mJ")].forEach((text, k) => write(row.cells[k], text));
    }
  }
}

function valueText(input) {
  const digits = (input.step.split(".")[1] ?? "").length, text = `${Number(input.value).toFixed(digits)} ${input.dataset.unit}`;
  write(input.previousElementSibling, text);
  input.setAttribute("aria-valuetext", text);
}
