// The page: takes records from the program, shows one of them and the traces around it.

import { BINS, BINS_PER_DECADE, Records, STAGES, quantile_us } from "./records.js";
import { CanvasPen, SvgPen } from "./pen.js";
import { drawScene, posture, projection } from "./scene.js";
import { Charts } from "./charts.js";
import { Play } from "./play.js";

const LIVE_SPAN_S = 60;
/// Most bytes that the page holds of one recording, and of a running rig.
const LARGEST_RECORDING = 1e9;
const LARGEST_LIVE = 256e6;
const TEXT_INTERVAL_MS = 100;
const RETRY_MS = [1000, 2000, 4000, 8000, 15000, 30000, 30000, 30000];
const STATES = ["idle", "enabling", "running", "holding", "stopping", "stopped", "disabled", "lost"];
const ALARMS = ["holding", "stopping", "stopped", "disabled", "lost"];
const DRIVE_ALARMS = ["quick-stop-active", "fault-reaction-active", "fault"];
const COLORS = ["ink", "muted", "panel", "grid", "edge", "tool", "proxy", "path", "force", "power", "energy", "other", "proximal", "distal", "surface", "forbidden"];

const $ = (id) => document.getElementById(id);
const make = (tag, className = "", text = "") => Object.assign(document.createElement(tag), { className, textContent: text });
function write(element, text) { if (element.textContent !== text) element.textContent = text; }

const page = {
  token: location.hash.slice(1),
  hello: null,
  socket: null,
  /// Hand, controls and guide of a program that takes orders.
  playing: null,
  main: null,
  other: null,
  charts: null,
  colors: {},
  isLive: false,
  isPlaying: false,
  isFollowing: false,
  shown: 0,
  time: 0,
  /// Record to go to as soon as it is loaded; null without one.
  wanted: null,
  /// Recording that is loaded as a whole; null without one.
  loaded: null,
  /// Recording that lies over it, and whether its surfaces differ.
  otherLoaded: -1,
  hasOtherSurfaces: false,
  /// Whether the next packet is the first after a lost connection, and when the last packet came, in ms.
  isResuming: false,
  received: 0,
  zoom: 1,
  selection: null,
  hasEnded: false,
  attempts: 0,
  lagged: 0,
  status: null,
  drawn: { tool: [NaN, NaN], proxy: [NaN, NaN] },
  draws: [],
  drawCount: 0,
};

// --- connection ---

function connect() {
  if (!/^[0-9a-f]{32}$/i.test(page.token)) {
    notice("This address lacks its last part. Open the address as the command printed it, with the part after #.");
    badge("not connected", "lost");
    return;
  }
  badge("connecting");
  const socket = new WebSocket(`ws://${location.host}/stream`, ["yieldwall.v1", `token.${page.token}`]);
  page.socket = socket;
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => {
    try {
      if (typeof data === "string") message(JSON.parse(data)); else packet(new Uint8Array(data));
    } catch (error) {
      notice(`The page cannot read a message of the program: ${error.message}. Reload the page; if this stays, report it.`);
      badge("not connected", "lost");
      page.hasEnded = true;
      socket.close();
    }
  };
  socket.onclose = ({ code }) => closed(code);
}

function send(order) {
  if (page.socket?.readyState === WebSocket.OPEN) page.socket.send(JSON.stringify(order));
}

function message(data) {
  if (data.kind === "hello") begin(data);
  if (data.kind === "lagged") page.lagged += data.records;
  if (data.kind === "status") page.status = data;
  if (data.kind === "notice") page.playing.notice(/^[a-z]+_/.test(data.message) ? data.message : sentence(data.message));
  if (data.kind === "end") {
    page.hasEnded = true;
    if (page.isLive) play(false);
    badge("ended");
    notice(`${sentence(data.message)} The page keeps what it received.`, { isCalm: true });
  }
  laterTexts();
}

function packet(bytes) {
  if (!page.main || !page.isLive) return;
  if (page.isResuming) resume(bytes);
  page.received = Date.now();
  const { main } = page, { runs } = main;
  main.take(bytes);
  if (main.runs !== runs) begunAnew();
  page.playing.take(main);
  if (page.isFollowing) follow();
  page.sceneChanged = true;
  if (!Array.isArray(page.selection)) page.charts.markAll();
  laterTexts();
  schedule();
}

async function closed(code) {
  page.playing.disconnected();
  if (page.hasEnded) return;
  if (page.hello && !page.isLive) {
    badge("recording, program ended");
    return;
  }
  badge("not connected", "lost");
  if (code === 1013) return retryLater("The program serves its largest number of pages already. Close another page.");
  if (code === 1008) return notice("The program refused the token. Open the address as the command printed it, with the part after #.", { canRetry: true });
  const status = await probe();
  if (status === 401 || status === 403) {
    return notice("The program refused the token. Open the address as the command printed it, with the part after #.", { canRetry: true });
  }
  if (status === null) {
    return retryLater(`${page.hello ? "The connection is lost: the" : "The"} program does not answer. If it has ended, start it again and open the address that it prints.`);
  }
  return retryLater("The connection is lost.");
}

/// HTTP status of the program's answer to the token; null without an answer.
async function probe() {
  try {
    const answer = await fetch("/metrics", { headers: { Authorization: `Bearer ${page.token}` }, signal: AbortSignal.timeout(5000) });
    return answer.status;
  } catch {
    return null;
  }
}

function retryLater(reason) {
  const wait = RETRY_MS[page.attempts];
  if (wait === undefined) return notice(`${reason} The page no longer tries by itself.`, { canRetry: true });
  page.attempts += 1;
  clearTimeout(page.retry);
  page.retry = setTimeout(connect, wait);
  return notice(`${reason} The page tries again in ${wait / 1000} s (${page.attempts} of ${RETRY_MS.length}).`, { canRetry: true });
}

function notice(text, { isCalm = false, canRetry = false } = {}) {
  $("notice").hidden = !text;
  $("notice").classList.toggle("calm", isCalm);
  write($("notice-text"), text);
  $("retry").hidden = !canRetry;
}

function badge(text, className = "") {
  write($("badge"), text);
  $("badge").className = `badge ${className}`;
}

// --- beginning ---

function begin(hello) {
  const isSameRig = page.isLive && hello.is_live && page.main && isEqual(hello.record, page.hello.record) && isEqual(machineOf(hello), page.main.machine);
  page.hello = hello;
  page.attempts = 0;
  page.status = null;
  notice("");
  write($("program"), `${hello.program}, ${hello.command}`);
  page.playing.begin(hello);
  if (isSameRig) {
    // The first packet shows whether the run is the same.
    page.isResuming = true;
    badge("live", "live");
    return;
  }
  const isAnew = page.isLive && hello.is_live;
  page.isLive = hello.is_live;
  page.loaded = null;
  document.body.classList.remove("waiting");
  $("live").hidden = !page.isLive;
  $("main-choice").hidden = page.isLive || hello.recordings.length < 2;
  $("other-choice").hidden = page.isLive || hello.recordings.length < 2;
  if (!isAnew) {
    page.selection = page.isLive ? null : "all";
    $("window").value = page.isLive ? "10" : "all";
  }
  write($("time-axis"), page.isLive ? "time since switching on (s)" : "time of the scene (s)");
  if (page.isLive) {
    badge("live", "live");
    beginLive();
  } else {
    page.isFollowing = false;
    play(false);
    const names = hello.recordings.map(({ name }) => name);
    options($("main-recording"), names);
    options($("other-recording"), ["none", ...names]);
    $("other-recording").value = names.length > 1 ? "2" : "0";
    loadChosen();
  }
}

/// Description of the machine in a message.
function machineOf({ name, period_s, arm, surfaces, view_m, fixture }) {
  return { name, period_s, arm, surfaces, view_m, fixture };
}

const isEqual = (a, b) => JSON.stringify(a) === JSON.stringify(b);

/// Begins an empty history of a running rig and follows it.
function beginLive() {
  const { hello } = page, wanted = LIVE_SPAN_S / (hello.period_s > 0 ? hello.period_s : 0.001);
  page.isResuming = false;
  followAnew();
  use(new Records(hello.record, machineOf(hello), Math.min(wanted, LARGEST_LIVE / (hello.record.bytes + Records.DERIVED_BYTES))), null);
}

/// Follows a run from its beginning.
function followAnew() {
  page.lagged = 0;
  page.isFollowing = true;
  page.isPlaying = true;
  write($("play"), "Pause");
  if (Array.isArray(page.selection)) {
    page.selection = null;
    $("window").value = "10";
  }
}

/// Goes on with another run of the same rig, whose first records have come.
function begunAnew() {
  followAnew();
  forgetShown();
  page.charts.markAll();
}

/// Goes on after a lost connection: counts the records of the gap as missed. Another run begins a new history.
function resume(bytes) {
  page.isResuming = false;
  const missed = page.main.missedBefore(bytes, (Date.now() - page.received) / 1000);
  if (Number.isNaN(missed)) beginLive(); else page.lagged += missed;
}

/// Writes what does not change from record to record: the description of the machine that made the shown records.
function machineTexts() {
  const { main, other } = page, { machine, words } = main, { yield_force_n: yield_n, law, rows: facts } = machine.fixture ?? {};
  write($("name"), machine.name || "yieldwall");
  document.title = `${machine.name} - yieldwall`;
  rows($("fixture"), [["Law", law ?? "none"], ...(facts ?? [])]);
  for (const key of [$("yield-key"), ...document.querySelectorAll(".yield-key")]) key.hidden = !(yield_n > 0);
  write($("yield"), `circle of the yield force R = ${yield_n} N`);
  $("forbidden-key").hidden = !(machine.surfaces ?? []).some((surface) => surface.forbidden !== "none");
  $("margin-panel").hidden = !machine.arm;
  write($("scene-title"), machine.arm ? "Arm and surfaces" : "Handle and surfaces");
  write($("tool-name"), words.tool);
  write($("force-name"), words.force);
  for (const option of $("zoom").options) if (option.value !== "1") write(option, `${words.tool}, ${option.value}x`);
  $("other-key").hidden = !other;
  if (other) write($("other-name"), otherName());
}

/// Name of the recording that lies over the shown one, with what differs.
function otherName() {
  const { main, other } = page, file = page.hello.recordings[page.otherLoaded].name;
  const [mine, its] = [main, other].map(({ machine }) => machine.fixture?.yield_force_n);
  const rig = other.machine.name === main.machine.name ? "" : `, ${other.machine.name}`;
  return `${file}${rig}${its === mine ? "" : `, ${its > 0 ? `R = ${its} N` : "no yield force"}`}`;
}

function options(select, names) {
  select.replaceChildren(...names.map((name, k) => Object.assign(make("option", "", name), { value: String(k) })));
}

/// Loads the chosen recording, and the one that is shown over it.
async function loadChosen() {
  const chosen = Number($("main-recording").value || 0);
  if ($("other-recording").value === String(chosen + 1)) $("other-recording").value = "0";
  const over = Number($("other-recording").value || 0) - 1;
  page.loading?.abort();
  const loading = new AbortController();
  page.loading = loading;
  try {
    badge("loading");
    if (page.loaded !== chosen) {
      play(false);
      page.loaded = null;
      page.wanted ??= page.shown;
      notice("");
      const main = await load(chosen, loading.signal, (records) => use(records, null));
      if (page.wanted !== null) show(page.wanted);
      page.wanted = null;
      page.loaded = chosen;
      document.body.classList.toggle("empty", main.total === 0);
      if (main.total === 0) notice(`${page.hello.recordings[chosen].name} has no records.`, { isCalm: true });
    }
    const other = over >= 0 ? await load(over, loading.signal, () => {}) : null;
    page.otherLoaded = over;
    if (other !== page.other) use(page.main, other);
    badge("recording");
  } catch (error) {
    if (loading.signal.aborted) return;
    badge("not loaded", "lost");
    notice(`The recording cannot be loaded: ${error.message}. Start the command again and open the address that it prints.`);
  }
}

async function load(which, signal, whenBegun) {
  const { records: count, name, machine } = page.hello.recordings[which];
  const most = Math.floor(LARGEST_RECORDING / (page.hello.record.bytes + Records.DERIVED_BYTES));
  const answer = await fetch(`/recordings/${which}`, { headers: { Authorization: `Bearer ${page.token}` }, signal });
  if (!answer.ok) throw new Error(`the program answered ${answer.status}`);
  if (count > most) notice(`${name} has ${count.toLocaleString("en")} records. The page shows the first ${most.toLocaleString("en")}, which take about 1 GB.`, { isCalm: true });
  const records = new Records(page.hello.record, machine, Math.min(count, most));
  whenBegun(records);
  const reader = answer.body.getReader();
  let rest = new Uint8Array(0);
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    const bytes = new Uint8Array(rest.length + value.length);
    bytes.set(rest);
    bytes.set(value, rest.length);
    rest = bytes.subarray(records.take(bytes, true));
    if (records === page.main) {
      if (page.wanted !== null) show(page.wanted);
      changed();
    }
    if (records.total === records.capacity) {
      await reader.cancel();
      break;
    }
  }
  return records;
}

function use(main, other) {
  if (main !== page.main) {
    forgetShown();
    document.body.classList.remove("empty");
  }
  page.main = main;
  page.other = other;
  page.hasOtherSurfaces = Boolean(other) && !isEqual(other.machine.surfaces, main.machine.surfaces);
  page.charts?.destroy();
  page.charts = new Charts($("charts"), main, other, {
    seek: (time) => seek(main.at(time + offset(main))),
    zoom: (low, high) => select([low, high]),
    reset: () => select("all"),
    changed: () => schedule(),
  });
  machineTexts();
  page.charts.build(page.colors, Boolean(other));
  changed();
}

function forgetShown() {
  page.shown = 0;
  page.time = 0;
  page.listedFaults = null;
  page.stageCounts = null;
  page.announced = null;
}

/// Time on the records' clock that the page shows as zero.
function offset(records) {
  if (page.isLive || records.total === 0) return 0;
  return Number.isFinite(records.sceneStart) ? records.sceneStart : records.time(records.first);
}

// --- the shown record ---

const shownTime = () => page.main.time(page.shown) - offset(page.main);

function follow() {
  page.shown = Math.max(0, page.main.last);
  page.time = shownTime();
}

/// Shows the record with an index, or the nearest one that is held.
function show(index) {
  const { main } = page;
  if (main.total === 0) return;
  page.shown = Math.min(Math.max(Math.round(index), main.first), main.last);
  page.time = shownTime();
  page.sceneChanged = true;
}

/// Shows another record if the shown one is no longer held.
function keepShown() {
  if (page.main.total > 0 && !page.main.holds(page.shown)) show(page.shown);
}

function seek(index) {
  const { main } = page;
  if (!main || main.total === 0) return;
  page.isFollowing = false;
  page.wanted = null;
  show(index);
  if (page.selection === null) page.charts.markAll();
  laterTexts();
  schedule();
}

/// Goes to an index and stays there.
function stopAt(index) {
  play(false);
  seek(index);
}

function play(isPlaying) {
  if (isPlaying && !(page.main?.total > 0)) {
    if (page.isLive && !page.hasEnded) goLive();
    return;
  }
  page.isPlaying = isPlaying;
  if (isPlaying) page.wanted = null;
  if (!isPlaying) page.isFollowing = false;
  else if (page.shown >= page.main.last && (!page.isLive || page.hasEnded)) seek(page.main.first);
  page.frameTime = null;
  write($("play"), isPlaying ? "Pause" : "Play");
  laterTexts();
  schedule();
}

function goLive() {
  page.isFollowing = true;
  page.isPlaying = true;
  write($("play"), "Pause");
  follow();
  changed();
}

function jump(list, direction) {
  const { main } = page;
  if (!main) return;
  const there = main[list].filter((index) => index >= main.first);
  const index = direction > 0 ? there.find((at) => at > page.shown) : there.findLast((at) => at < page.shown);
  if (index !== undefined) stopAt(index);
}

/// Time span of the traces.
function span() {
  const { main, selection } = page;
  if (Array.isArray(selection)) return selection;
  const zero = offset(main), first = main.time(main.first) - zero, last = main.time(main.last) - zero;
  const isEmpty = !(last > first);
  if (selection === "all") return isEmpty ? [0, 1] : [first, last];
  const width = Number($("window").value) || 10;
  if (isEmpty) return [0, width];
  if (page.isFollowing) return [last - width, last];
  if (page.isLive) return [page.time - 0.75 * width, page.time + 0.25 * width];
  const low = first + Math.floor((page.time - first) / width) * width;
  return [low, low + width];
}

function select(selection) {
  page.selection = selection;
  $("window").querySelector("[value=custom]").hidden = !Array.isArray(selection);
  if (Array.isArray(selection)) $("window").value = "custom";
  if (selection === "all") $("window").value = "all";
  changed();
}

/// Chooses the next option of a list, after the last the first.
function nextOption(element) {
  const usable = [...element.options].filter((option) => !option.hidden);
  element.value = usable[(usable.findIndex((option) => option.value === element.value) + 1) % usable.length].value;
  element.dispatchEvent(new Event("change"));
}

// --- drawing ---

function changed() {
  page.sceneChanged = true;
  page.charts?.markAll();
  laterTexts();
  schedule();
}

function schedule() {
  if (page.isScheduled) return;
  page.isScheduled = true;
  requestAnimationFrame(frame);
}

function frame(now) {
  page.isScheduled = false;
  const { main, charts } = page;
  if (!main || !charts) return;
  keepShown();
  advance(now);
  if (page.sceneChanged && main.total > 0) {
    page.sceneChanged = false;
    draw();
    page.drawCount += 1;
    page.draws.push(now);
    if (page.draws.length > 1200) page.draws.splice(0, 600);
  }
  const other = page.other && { records: page.other, offset: offset(page.other) };
  const isWaiting = main.total > 0 && charts.draw(span(), { records: main, offset: offset(main) }, other, page.isPlaying ? 1 : 9);
  charts.moveTo(page.time, !page.isFollowing);
  if (isWaiting || (page.isPlaying && !page.isFollowing)) schedule();
}

/// Moves the shown record on while a recording plays.
function advance(now) {
  const { main } = page;
  if (!page.isPlaying || page.isFollowing || main.total === 0) {
    page.frameTime = null;
    return;
  }
  const elapsed = page.frameTime === null || page.frameTime === undefined ? 0 : Math.min((now - page.frameTime) / 1000, 0.25);
  page.frameTime = now;
  const before = span();
  page.time += elapsed * Number($("speed").value);
  const index = main.at(page.time + offset(main));
  if (index !== page.shown) {
    page.shown = index;
    page.sceneChanged = true;
    laterTexts();
  }
  const after = span();
  if (before[0] !== after[0] || before[1] !== after[1]) page.charts.markAll();
  if (index >= main.last) {
    if (page.isLive && !page.hasEnded) goLive(); else play(false);
  }
}

function shownScene() {
  const { main: records, shown: index, other, zoom } = page;
  const over = other && other.total > 0 ? { records: other, index: other.at(page.time + offset(other)), hasOwnSurfaces: page.hasOtherSurfaces } : null;
  return { records, index, other: over, zoom, hand: page.playing.drawn() };
}

/// Projection of the scene as it is shown.
function place() {
  const { clientWidth, clientHeight } = $("scene"), { main, zoom } = page;
  const focus = zoom > 1 ? [main.get.toolX, main.get.toolY].map((get) => get(main.place(page.shown))) : null;
  return projection(main?.machine.view_m, clientWidth, clientHeight, zoom, focus);
}

function draw() {
  const canvas = $("scene"), { width, height } = sized(canvas);
  const context = canvas.getContext("2d", { alpha: false });
  context.setTransform(canvas.width / width, 0, 0, canvas.height / height, 0, 0);
  page.drawn = drawScene(new CanvasPen(context), { width, height }, shownScene(), page.colors);
}

/// Fits a canvas's pixels to its box; returns the box in CSS pixels.
function sized(canvas) {
  const width = canvas.clientWidth || 1, height = canvas.clientHeight || 1, ratio = devicePixelRatio || 1;
  const pixels = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== pixels[0] || canvas.height !== pixels[1]) [canvas.width, canvas.height] = pixels;
  return { width, height };
}

function readColors() {
  const probe = make("span");
  document.body.append(probe);
  for (const name of COLORS) {
    probe.style.color = `var(--${name})`;
    page.colors[name] = getComputedStyle(probe).color;
  }
  page.colors.forceText = page.colors.force;
  probe.remove();
  page.charts?.build(page.colors, Boolean(page.other));
  changed();
}

// --- texts ---

function laterTexts() {
  page.textTimer ??= setTimeout(() => {
    page.textTimer = null;
    texts();
  }, TEXT_INTERVAL_MS);
}

function rows(list, pairs) {
  while (list.children.length > pairs.length) list.lastChild.remove();
  pairs.forEach(([name, value, isAlarm], k) => {
    const row = list.children[k] ?? list.appendChild(make("div"));
    if (row.children.length === 0) row.append(make("dt"), make("dd"));
    write(row.children[0], name);
    write(row.children[1], value);
    row.children[1].className = isAlarm ? "alarm" : "";
  });
}

const withUnit = (value, factor, digits, unit) => (Number.isFinite(value) ? `${(value * factor).toFixed(digits)} ${unit}` : "no value");
const yesOrNo = (value) => (value ? "yes" : "no");

function texts() {
  const { main } = page;
  if (!main) return;
  streamTexts();
  page.playing.texts(main);
  if (main.total === 0) return;
  keepShown();
  stateTexts();
  faultTexts();
  marginTexts();
  stageTexts();
  page.charts.write(main, page.shown);
  timeTexts();
  describe();
}

/// State of the supervisor; null where there is none, as beside simulated devices without their master.
function supervisor(main, index) {
  return page.hello.command === "sim" ? null : main.code("state", index);
}

function stateTexts() {
  const { main, shown: index } = page, hasMaster = page.hello.command !== "sim";
  const state = supervisor(main, index), list = $("states");
  list.hidden = state === null;
  if (state !== null && list.children.length === 0) list.append(...STATES.map((name) => make("li", "", name)));
  for (const item of list.children) {
    const isNow = item.textContent === state;
    item.className = isNow ? `now${ALARMS.includes(state) ? " alarm" : ""}` : "";
    if (isNow) item.setAttribute("aria-current", "true"); else item.removeAttribute("aria-current");
  }
  const value = (name) => main.value(name, index);
  const coded = (name, label) => {
    const text = main.code(name, index);
    return main.has(name) ? [[label, text, DRIVE_ALARMS.includes(text)]] : [];
  };
  rows($("values"), [
    ...coded("left_state", "Left drive"),
    ...coded("right_state", "Right drive"),
    ...(hasMaster ? [...coded("motion", "Reference"), ...coded("command_kind", "Command")] : []),
    ["Force", withUnit(main.column("force", index), 1, 1, "N")],
    ...(hasMaster ? [
      ["Proxy to surface", withUnit(value("signed_distance_m"), 1000, 2, "mm")],
      [`${capital(main.words.tool)} to proxy`, withUnit(main.column("distance", index), 1000, 2, "mm")],
      ["Proxy on the surface", yesOrNo(value("is_on_surface"))],
      ["Hold counter", withUnit(value("hold_counter"), 1, 0, main.fields.get("hold_counter")?.unit ?? "")],
      ...(main.has("is_saturated") ? [["Torque at its limit", yesOrNo(value("is_saturated")), value("is_saturated") === 1]] : []),
    ] : []),
  ]);
}

function faultTexts() {
  const { main, shown: index, hello } = page;
  const before = main.faults.filter((at) => at <= index && at >= main.first);
  const isNow = main.value("has_cause", index) === 1;
  const at = isNow ? index : before.at(-1);
  const there = main.faults.filter((fault) => fault >= main.first);
  $("fault-panel").hidden = !main.has("has_cause");
  $("fault").hidden = at === undefined;
  $("fault").classList.toggle("past", !isNow);
  $("fault-none").hidden = at !== undefined;
  write($("fault-none"), there.length > 0 ? "no fault up to this record" : "no fault so far");
  if (at !== undefined) {
    const name = main.code("cause", at), fault = hello.faults?.[name] ?? {}, devices = main.set("cause_devices", at);
    write($("fault-name"), name);
    write($("fault-devices"), `${devices.length > 0 ? `${devices.join(", ")}, ` : ""}${isNow ? "now" : `past, ${(main.time(at) - offset(main)).toFixed(3)} s`}`);
    write($("fault-meaning"), sentence(fault.meaning));
    write($("fault-reaction"), fault.reaction ?? "unknown");
    withCode($("fault-next"), fault.next ?? "see the table of faults");
  }
  const listed = there.slice(-5), key = `${listed}:${main.sceneStart}`;
  if (page.listedFaults === key) return;
  page.listedFaults = key;
  $("fault-list").replaceChildren(...listed.map((fault) => {
    const button = make("button", "", `${(main.time(fault) - offset(main)).toFixed(2)} s ${main.code("cause", fault)}`);
    button.type = "button";
    button.addEventListener("click", () => stopAt(fault));
    const item = make("li");
    item.append(button);
    return item;
  }));
}

const capital = (text) => `${text.charAt(0).toUpperCase()}${text.slice(1)}`;

/// Makes a sentence of a text: a capital first, a stop last.
function sentence(text) {
  const trimmed = (text ?? "").trim();
  return trimmed === "" || /[.!?]$/.test(trimmed) ? capital(trimmed) : `${capital(trimmed)}.`;
}

/// Writes a text whose commands stand in backticks.
function withCode(element, text) {
  if (element.dataset.text === text) return;
  element.dataset.text = text;
  element.replaceChildren(...text.split("`").map((part, k) => (k % 2 ? make("code", "", part) : document.createTextNode(part))));
}

function marginTexts() {
  const { main, shown: index } = page;
  if (!main.machine.arm) return;
  const arm = posture(main, index), list = $("margins"), limit = main.machine.arm.singularity_margin_m;
  if (!arm) {
    list.replaceChildren();
    write($("nearest"), "The angles of this record are missing or not finite.");
    return;
  }
  const nearest = (chain) => arm.margins.filter((margin) => margin.chain === chain).reduce((a, b) => (b.margin_m < a.margin_m ? b : a));
  const most = arm.halfReach_m;
  const all = [nearest(0), nearest(1), nearest(null)];
  if (list.children.length !== 4) list.replaceChildren(...["", "", "", ""].map(() => meter()));
  all.forEach(({ name, margin_m }, k) => {
    set(list.children[k], name, `${(margin_m * 1000).toFixed(0)} mm`, margin_m / most, limit !== null && limit !== undefined ? limit / most : null, margin_m < (limit ?? 0));
  });
  const angle = arm.distalAngle_deg;
  set(list.children[3], "angle between the distal links", `${angle.toFixed(0)}\u00b0`, angle / 180, null, angle < 15 || angle > 165);
  write($("nearest"), `Nearest: ${arm.nearest.name}, ${(arm.nearest.margin_m * 1000).toFixed(0)} mm${limit > 0 ? `; limit ${(limit * 1000).toFixed(0)} mm` : ""}. A stretched or folded chain is a type 1 singularity. Distal links at 0\u00b0 or 180\u00b0 are a type 2 singularity.`);
}

function meter() {
  const whole = make("div", "meter"), bar = make("div", "bar");
  bar.append(make("div", "fill"), make("div", "limit"));
  bar.setAttribute("role", "meter");
  bar.setAttribute("aria-valuemin", "0");
  bar.setAttribute("aria-valuemax", "100");
  whole.append(make("span"), make("span", "number"), bar);
  return whole;
}

function set(whole, name, text, share, limit, isAlarm) {
  const [label, number, bar] = whole.children;
  const percent = Math.round(Math.min(Math.max(share, 0), 1) * 100);
  write(label, name);
  write(number, text);
  bar.className = `bar${isAlarm ? " alarm" : ""}`;
  bar.setAttribute("aria-label", name);
  bar.setAttribute("aria-valuenow", String(percent));
  bar.setAttribute("aria-valuetext", text);
  bar.children[0].style.width = `${percent}%`;
  bar.children[1].hidden = limit === null;
  if (limit !== null) bar.children[1].style.left = `${Math.min(limit, 1) * 100}%`;
}

function stageTexts() {
  const { main } = page, list = $("stages");
  const isThere = main.get.stages.some((reader) => reader);
  $("stages-panel").hidden = !isThere;
  if (!isThere) return;
  const areZero = main.worst.every((worst) => worst === 0);
  list.hidden = areZero;
  write($("stages-note"), areZero
    ? "The clock of this simulation stands still during a cycle: all stage times are zero."
    : "Bars: cycles on a logarithmic scale. Line: the cycle's period.");
  if (areZero) return;
  if (list.children.length === 0) {
    list.append(...STAGES.map(([, name]) => {
      const row = make("div", "stage-row"), canvas = make("canvas");
      canvas.setAttribute("role", "img");
      row.append(make("span", "", name), make("span", "number muted"), canvas);
      return row;
    }));
  }
  STAGES.forEach(([, name], k) => {
    const [, numbers, canvas] = list.children[k].children, bins = main.bins[k];
    const text = `median below ${micro(quantile_us(bins, 0.5))}, 99.9 % below ${micro(quantile_us(bins, 0.999))}, max ${micro(main.worst[k] / 1000)}`;
    if (numbers.textContent === text && page.stageCounts?.[k] === main.total) return;
    write(numbers, text);
    canvas.setAttribute("aria-label", `Histogram of the stage ${name}: ${text}`);
    histogram(canvas, bins, main.period_s);
  });
  page.stageCounts = STAGES.map(() => main.total);
}

const micro = (us) => (us >= 1000 ? `${(us / 1000).toPrecision(2)}\u00a0ms` : `${us.toPrecision(us >= 100 ? 3 : 2)}\u00a0\u00b5s`);

function histogram(canvas, bins, period_s) {
  const { width, height } = sized(canvas), context = canvas.getContext("2d");
  context.setTransform(canvas.width / width, 0, 0, canvas.height / height, 0, 0);
  context.clearRect(0, 0, width, height);
  const most = Math.log1p(Math.max(...bins)), step = width / BINS, low = height - 12;
  const { colors } = page;
  context.fillStyle = colors.proxy;
  bins.forEach((count, k) => {
    if (count === 0) return;
    const bar = Math.max(2, (Math.log1p(count) / most) * low);
    context.fillRect(k * step + 0.5, low - bar, Math.max(1, step - 1), bar);
  });
  context.fillStyle = colors.ink;
  context.fillRect(Math.log10(period_s * 1e6) * BINS_PER_DECADE * step, 0, 2, low);
  context.fillStyle = colors.edge;
  context.fillRect(0, low, width, 1);
  context.fillStyle = colors.muted;
  context.font = "10px system-ui, sans-serif";
  ["1 \u00b5s", "10", "100", "1 ms", "10 ms"].forEach((text, k) => {
    context.textAlign = k === 0 ? "left" : "center";
    context.fillText(text, k * BINS_PER_DECADE * step, height - 2);
  });
}

function streamTexts() {
  const { main, hello, status } = page;
  const buses = status?.buses ?? [], list = $("buses");
  while (list.children.length > buses.length) list.lastChild.remove();
  buses.forEach(({ name, load_percent: load }, k) => {
    if (!list.children[k]) list.append(meter());
    const isKnown = Number.isFinite(load);
    set(list.children[k], `Load of ${name}, at most`, isKnown ? `${load.toFixed(1)} %` : "unknown", isKnown ? load / 100 : 0, null, load > 80);
  });
  rows($("stream"), [
    ["Real-time tier", hello.tier ?? "unknown"],
    ["Period", withUnit(main.machine.period_s, 1000, 3, "ms")],
    ["Records", `${main.total}`],
    ...(page.isLive ? [
      ["Lost in the program", `${Math.max(main.serverLost, status?.lost ?? 0)}`],
      ["Missed by this page", `${page.lagged}`],
      ["Pages open", status ? `${status.clients}` : "unknown"],
      ["Connections refused", status ? `${status.refused}` : "unknown"],
    ] : []),
  ]);
}

function timeTexts() {
  const { main, shown: index } = page, scrub = $("scrub"), time = shownTime();
  const first = String(main.first), last = String(main.last);
  if (scrub.min !== first) scrub.min = first;
  if (scrub.max !== last) scrub.max = last;
  if (scrub.value !== String(index)) scrub.value = String(index);
  scrub.setAttribute("aria-valuetext", `${time.toFixed(3)} s`);
  write($("time"), `${time.toFixed(3)} s`);
  $("live").disabled = page.isFollowing || page.hasEnded;
  for (const [name, direction] of [["previous", -1], ["next", 1]]) {
    for (const [list, suffix] of [["faults", "fault"], ["impacts", "impact"]]) {
      $(`${name}-${suffix}`).disabled = !main[list].some((at) => at >= main.first && (direction > 0 ? at > index : at < index));
    }
  }
  marks();
}

/// Faults and impacts along the slider.
function marks() {
  const { main } = page, canvas = $("marks"), { width, height } = sized(canvas), context = canvas.getContext("2d");
  context.setTransform(canvas.width / width, 0, 0, canvas.height / height, 0, 0);
  context.clearRect(0, 0, width, height);
  const knob = 8, all = Math.max(1, main.last - main.first);
  const at = (index) => knob + ((index - main.first) / all) * (width - 2 * knob);
  context.fillStyle = page.colors.proxy;
  for (const index of main.impacts) if (index >= main.first) context.fillRect(at(index) - 0.5, 4, 1, height - 4);
  context.fillStyle = page.colors.tool;
  for (const index of main.faults) {
    if (index < main.first) continue;
    context.beginPath();
    context.moveTo(at(index), 0);
    context.lineTo(at(index) + 4, height);
    context.lineTo(at(index) - 4, height);
    context.fill();
  }
}

/// Writes for a screen reader: the canvas's content, and changes of state as they come.
function describe() {
  const { main, shown: index } = page;
  const state = supervisor(main, index), fault = main.value("has_cause", index) === 1 ? main.code("cause", index) : null;
  $("scene").setAttribute("aria-label", `${$("scene-title").textContent} at ${shownTime().toFixed(1)} s: ${main.words.force} ${withUnit(main.column("force", index), 1, 1, "N")}, ${main.words.tool} to proxy ${withUnit(main.column("distance", index), 1000, 1, "mm")}`);
  const text = `${state ? `Supervisor: ${state}.` : ""}${fault ? ` Fault: ${fault}.` : ""}`;
  if (page.announced !== text) {
    page.announced = text;
    write($("announcement"), text);
    document.title = `${fault ? `${fault}: ` : ""}${main.machine.name} - yieldwall`;
  }
}

// --- files ---

const EXPORT = { width: 1280, height: 760, scene: 600 };

function compose(pen) {
  const { main, shown: index, colors, hello } = page, { width, height, scene } = EXPORT, { machine, words } = main, yield_n = machine.fixture?.yield_force_n;
  pen.box(0, 0, width, height, colors.panel);
  pen.text(20, 32, machine.name, { color: colors.ink, size: 19, weight: 700 });
  pen.text(width - 20, 32, `${hello.program}, ${shownTime().toFixed(3)} s`, { color: colors.muted, size: 13, anchor: "end" });
  pen.within(20, 50, scene, scene, (inner) => drawScene(inner, { width: scene, height: scene }, shownScene(), colors));
  const other = page.other && { records: page.other, offset: offset(page.other) };
  page.charts.export(pen, { x: scene + 50, y: 44, width: width - scene - 70, height: scene + 20 }, span(), { records: main, offset: offset(main) }, other, page.time);
  pen.text(width - 20, 50 + scene + 28, $("time-axis").textContent, { color: colors.muted, size: 12, anchor: "end" });
  const legend = [["tool", words.tool], ["proxy", "proxy"], ["path", "path of the proxy"], ["force", `${words.force}${yield_n > 0 ? `, circle R = ${yield_n} N` : ""}`], ...(other ? [["other", $("other-name").textContent]] : [])];
  let x = 20;
  for (const [color, name] of legend) {
    pen.circle(x + 6, 50 + scene + 23, 5, { fill: colors[color] });
    pen.text(x + 16, 50 + scene + 28, name, { color: colors.ink, size: 13 });
    x += 36 + name.length * 7;
  }
  const state = supervisor(main, index);
  const facts = [state && `supervisor ${state}`, main.has("left_state") && `drives ${main.code("left_state", index)}, ${main.code("right_state", index)}`, `${words.force} ${withUnit(main.column("force", index), 1, 1, "N")}`, `${words.tool} to proxy ${withUnit(main.column("distance", index), 1000, 2, "mm")}`];
  pen.text(20, 50 + scene + 56, facts.filter(Boolean).join("; "), { color: colors.ink, size: 13 });
  if (main.value("has_cause", index) === 1) {
    const name = main.code("cause", index);
    pen.text(20, 50 + scene + 80, `fault ${name}: ${hello.faults?.[name]?.meaning ?? ""}`, { color: colors.tool, size: 13, weight: 600 });
  }
  page.charts.markAll();
  schedule();
}

function fileName(ending) {
  return `${page.main.machine.name.replace(/[^\w.-]+/g, "-")}-${shownTime().toFixed(3)}s.${ending}`;
}

function download(blob, name) {
  const link = make("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

function saveSvg() {
  if (!page.main?.total) return;
  const pen = new SvgPen();
  compose(pen);
  download(new Blob([pen.document(EXPORT.width, EXPORT.height, page.main.machine.name)], { type: "image/svg+xml" }), fileName("svg"));
}

function savePng() {
  if (!page.main?.total) return;
  const canvas = make("canvas"), name = fileName("png");
  [canvas.width, canvas.height] = [EXPORT.width * 2, EXPORT.height * 2];
  const context = canvas.getContext("2d");
  context.scale(2, 2);
  compose(new CanvasPen(context));
  canvas.toBlob((blob) => download(blob, name), "image/png");
}

// --- controls ---

function isDark() {
  const { theme } = document.documentElement.dataset;
  return theme ? theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

function themeChanged() {
  write($("theme"), isDark() ? "Light" : "Dark");
  readColors();
}

function switchTheme() {
  document.documentElement.dataset.theme = isDark() ? "light" : "dark";
  themeChanged();
}

function faster(by) {
  const select = $("speed");
  select.selectedIndex = Math.min(Math.max(select.selectedIndex + by, 0), select.options.length - 1);
}

const KEYS = {
  " ": () => play(!page.isPlaying),
  ArrowLeft: ({ shiftKey }) => stopAt(page.shown - (shiftKey ? 100 : 1)),
  ArrowRight: ({ shiftKey }) => stopAt(page.shown + (shiftKey ? 100 : 1)),
  Home: () => stopAt(page.main.first),
  End: () => (page.isLive && !page.hasEnded ? goLive() : stopAt(page.main.last)),
  "[": () => jump("faults", -1),
  "]": () => jump("faults", 1),
  ",": () => jump("impacts", -1),
  ".": () => jump("impacts", 1),
  "-": () => faster(-1),
  "+": () => faster(1),
  "=": () => faster(1),
  w: () => nextOption($("window")),
  z: () => nextOption($("zoom")),
  t: switchTheme,
  "?": () => $("help").showModal(),
};
/// Keys with Shift: they download a file.
const SHIFT_KEYS = { s: saveSvg, p: savePng };

function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || $("help").open) return;
  const { target } = event;
  if (target instanceof HTMLSelectElement || (target instanceof HTMLInputElement && target.id !== "scrub")) return;
  if (event.key === " " && target.closest?.("button, summary")) return;
  const name = event.key.toLowerCase();
  const act = (event.shiftKey ? SHIFT_KEYS[name] : null) ?? KEYS[event.key] ?? KEYS[name];
  if (!act || (!page.main && !["t", "?"].includes(event.key))) return;
  event.preventDefault();
  act(event);
}

function begun() {
  const on = (id, kind, act) => $(id).addEventListener(kind, act);
  on("play", "click", () => play(!page.isPlaying));
  on("live", "click", goLive);
  on("previous-fault", "click", () => jump("faults", -1));
  on("next-fault", "click", () => jump("faults", 1));
  on("previous-impact", "click", () => jump("impacts", -1));
  on("next-impact", "click", () => jump("impacts", 1));
  on("scrub", "input", () => stopAt(Number($("scrub").value)));
  on("save-svg", "click", saveSvg);
  on("save-png", "click", savePng);
  on("theme", "click", switchTheme);
  on("keys", "click", () => $("help").showModal());
  on("retry", "click", () => { page.attempts = 0; clearTimeout(page.retry); notice(""); connect(); });
  on("main-recording", "change", loadChosen);
  on("other-recording", "change", loadChosen);
  on("zoom", "change", () => { page.zoom = Number($("zoom").value); changed(); });
  on("window", "change", () => select($("window").value === "all" ? "all" : null));
  page.playing = new Play($("scene"), {
    send,
    place,
    tool: () => (page.main?.total > 0 ? [page.main.get.toolX, page.main.get.toolY].map((get) => get?.(page.main.place(page.main.last))) : null),
    live: () => { if (!page.isFollowing && page.main && !page.hasEnded) goLive(); },
    changed: () => { page.sceneChanged = true; schedule(); },
  });
  document.addEventListener("keydown", onKey);
  addEventListener("hashchange", () => location.reload());
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", themeChanged);
  new ResizeObserver(() => { page.sceneChanged = true; laterTexts(); schedule(); }).observe($("scene"));
  themeChanged();
  connect();
}

/// Read-only, for tests.
window.yieldwall = Object.freeze({
  toPixels: (x_m, y_m) => place().to(x_m, y_m),
  now: () => performance.now(),
  get draws() { return page.drawCount; },
  get drawTimes() { return page.draws.slice(); },
  get shown() { return page.shown; },
  get total() { return page.main?.total ?? 0; },
  get tool() { return page.drawn.tool.slice(); },
  get proxy() { return page.drawn.proxy.slice(); },
  get colors() { return { ...page.colors }; },
  get machine() { return structuredClone(page.main?.machine ?? null); },
  get play() { return structuredClone(page.playing.play ?? null); },
  get hand() { const { aim, isHeld } = page.playing.hand; return { aim: aim?.slice() ?? null, isHeld }; },
  get guide() { return structuredClone({ step: page.playing.guide.step, results: page.playing.guide.results }); },
  value: (name) => page.main?.value(name, page.main.last) ?? NaN,
  /// Number of the last record, and the energy up to it in J.
  get energy() { return page.main ? [page.main.last, page.main.column("energy", page.main.last)] : null; },
});

begun();
