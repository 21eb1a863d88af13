// The arm, the surfaces, proxy, tool and force of one record, seen along z.

const PADDING = 10;
/// Force of an arrow of unit length where no yield force is known, N.
const USUAL_N = 20;
/// Radius on the screen of the circle of the yield force.
const YIELD_SHARE = 0.11;
/// Longest arrow, in radii of that circle.
const LONGEST_ARROW = 3;
const HATCH = { spacing: 9, length: 10 };
export const PROXY_RADIUS = 9;
export const TOOL_RADIUS = 5;

/// Place of base-frame metres on a box of CSS pixels, `zoom` times as large around `focus` as the whole view.
export function projection(view, width, height, zoom = 1, focus = null) {
  const usable = view && view.every(Number.isFinite) && view[2] > view[0] && view[3] > view[1];
  const [left, low, right, high] = usable ? view : [-0.5, -0.5, 0.5, 0.5];
  const scale = zoom * Math.max(1, Math.min((width - 2 * PADDING) / (right - left), (height - 2 * PADDING) / (high - low)));
  const [x, y] = zoom > 1 && focus?.every(Number.isFinite) ? focus : [(left + right) / 2, (low + high) / 2];
  return {
    scale,
    to: (px, py) => [width / 2 + (px - x) * scale, height / 2 - (py - y) * scale],
    from: (left_px, top_px) => [x + (left_px - width / 2) / scale, y - (top_px - height / 2) / scale],
  };
}

const pair = (value) => (Array.isArray(value) ? value : [value, value]);
const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

/// Product of two complex numbers, each [real, imaginary].
const times = ([a, b], [c, d]) => [a * c - b * d, a * d + b * c];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1]];
const plus = (a, b) => [a[0] + b[0], a[1] + b[1]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1];

/// Joints of the five-bar and its margins to singularities at a record; null without an arm or its angles.
///
/// The margins are the guard's: the chain that carries the tool is measured to the tool point, the other to the wrist.
export function posture(records, index) {
  const { arm } = records.machine;
  if (!arm) return null;
  const value = (name) => records.value(name, index);
  const angles = [
    records.has("measured_left_rad") ? value("measured_left_rad") : value("left_angle_rad"),
    records.has("measured_right_rad") ? value("measured_right_rad") : value("right_angle_rad"),
  ];
  const tool = [value("tool_x_m"), value("tool_y_m")];
  if (![...angles, ...tool].every(Number.isFinite)) return null;
  const proximal = pair(arm.proximal_m), distal = pair(arm.distal_m);
  const elbows = angles.map((angle, k) => [arm.bases_m[k][0] + proximal[k] * Math.cos(angle), arm.bases_m[k][1] + proximal[k] * Math.sin(angle)]);
  const held = arm.tool.fixed_to === "right" ? 1 : 0, free = 1 - held;
  // Complex ratio of elbow -> tool point to elbow -> wrist on the link that carries the tool.
  const ratio = [1 + arm.tool.along_m / distal[held], arm.tool.across_m / distal[held]];
  const square = dot(ratio, ratio), inverse = [ratio[0] / square, -ratio[1] / square];
  const guess = plus(elbows[held], times(minus(tool, elbows[held]), inverse));
  const wrist = meet(elbows, distal, guess) ?? guess;
  const tip = plus(elbows[held], times(minus(wrist, elbows[held]), ratio));
  const carried = distal.map((length, k) => (k === held ? length * Math.sqrt(square) : length));
  const reach = arm.bases_m.map((base, k) => distance(base, k === held ? tip : wrist));
  const parted = distance(...elbows);
  const toElbows = elbows.map((elbow) => [elbow[0] - wrist[0], elbow[1] - wrist[1]]);
  const [[ax, ay], [bx, by]] = toElbows;
  const margins = [
    { name: "left chain stretched", chain: 0, margin_m: proximal[0] + carried[0] - reach[0] },
    { name: "left chain folded", chain: 0, margin_m: reach[0] - Math.abs(proximal[0] - carried[0]) },
    { name: "right chain stretched", chain: 1, margin_m: proximal[1] + carried[1] - reach[1] },
    { name: "right chain folded", chain: 1, margin_m: reach[1] - Math.abs(proximal[1] - carried[1]) },
    { name: "distal links stretched", chain: null, margin_m: distal[0] + distal[1] - parted },
    { name: "distal links folded", chain: null, margin_m: parted - Math.abs(distal[0] - distal[1]) },
  ];
  if (arm.tool.along_m !== 0 || arm.tool.across_m !== 0) {
    const gap_m = Math.min(...margins.filter(({ chain }) => chain === free).map(({ margin_m }) => margin_m));
    const way_m = toolWay({ base: arm.bases_m, elbow: elbows[held], tip, wrist, held, free, inverse }, gap_m);
    if (Number.isFinite(way_m)) margins.push({ name: `${free === 0 ? "left" : "right"} chain, edge of the workspace`, chain: free, margin_m: way_m });
  }
  const angle = Math.abs(Math.atan2(ax * by - ay * bx, ax * bx + ay * by));
  return { bases: arm.bases_m, elbows, wrist, tool, margins, halfReach_m: (Math.min(...proximal) + Math.min(...distal)) / 2, distalAngle_deg: (angle * 180) / Math.PI, nearest: margins.reduce((a, b) => (b.margin_m < a.margin_m ? b : a)) };
}

/// Way of the tool point, to first order, along which the reach of the chain without the tool changes by `gap_m`.
function toolWay({ base, elbow, tip, wrist, held, free, inverse: w }, gap_m) {
  const carried = minus(tip, elbow), [cx, cy] = minus(elbow, base[held]), crank = [-cy, cx];
  const reach = minus(wrist, base[free]), length = Math.hypot(...reach);
  if (!(length > 0)) return gap_m;
  const lever = dot(carried, crank);
  const along = times(crank, [1 - w[0], -w[1]]);
  const [rx, ry] = times(reach, [w[0], -w[1]]), share = dot(along, reach);
  const gradient = Math.hypot(rx * lever + carried[0] * share, ry * lever + carried[1] * share);
  return (gap_m * Math.abs(lever) * length) / gradient;
}

/// The point at the given distances from both elbows that lies nearer to `near`.
function meet([left, right], [a, b], near) {
  const base = distance(left, right), along = (a * a - b * b + base * base) / (2 * base);
  const square = a * a - along * along;
  if (!(base > 0) || !(square >= 0)) return null;
  const ux = (right[0] - left[0]) / base, uy = (right[1] - left[1]) / base, across = Math.sqrt(square);
  const [first, second] = [1, -1].map((side) => [left[0] + along * ux - side * across * uy, left[1] + along * uy + side * across * ux]);
  return distance(first, near) <= distance(second, near) ? first : second;
}

/// Draws a record, and another recording's record over it. Returns the pixels of tool and proxy.
export function drawScene(pen, size, shown, colors) {
  const { records, index, other, zoom, hand = null } = shown, { machine } = records;
  const value = (name) => records.value(name, index);
  const toolNames = records.isDevice ? ["reported_x_m", "reported_y_m"] : ["tool_x_m", "tool_y_m"];
  const tool_m = toolNames.map(value);
  const place = projection(machine.view_m, size.width, size.height, zoom, tool_m);
  pen.box(0, 0, size.width, size.height, colors.panel);
  const shift = shiftAt(records, index);
  for (const surface of machine.surfaces ?? []) drawSurface(pen, size, place, surface, shift, colors);
  if (other) drawOther(pen, place, other, colors);
  drawPath(pen, place, records, index, { color: colors.path, width: 2 });
  const arm = posture(records, index);
  if (arm) drawArm(pen, place, arm, colors);
  const tool = place.to(...tool_m);
  const proxy = place.to(value("proxy_x_m"), value("proxy_y_m"));
  // In play the arrow of the force ends at the point at which the hand aims.
  const yield_n = machine.fixture?.yield_force_n, unit_n = hand?.yield_n || yield_n || USUAL_N;
  const radius = hand?.reach_m > 0 ? hand.reach_m * place.scale : YIELD_SHARE * Math.min(size.width, size.height);
  if (hand?.aim) drawAim(pen, tool, place.to(...hand.aim), hand.isHeld, yield_n, colors);
  drawForce(pen, tool, radius, ["force_x_n", "force_y_n"].map(value), { unit_n, yield_n }, hand?.aim ? 27 : 16, colors);
  pen.circle(...tool, TOOL_RADIUS, { fill: colors.tool });
  pen.circle(...proxy, PROXY_RADIUS, { color: colors.proxy, width: 3 });
  drawScale(pen, size, place, colors);
  return { tool, proxy };
}

const finite = (value) => (Number.isFinite(value) ? value : 0);

/// Shift of the surfaces at a record from their first place.
const shiftAt = (records, index) => ["surface_x_m", "surface_y_m"].map((name) => finite(records.value(name, index)));

// JSON has no infinite numbers: such a coordinate arrives as null.
const corners = (place, points_m, [dx, dy]) => points_m.map(([x, y]) => place.to((x ?? NaN) + dx, (y ?? NaN) + dy));

function drawSurface(pen, size, place, { points_m, is_closed, forbidden }, shift, colors) {
  const points = corners(place, points_m, shift);
  if (points.length < 2) return;
  const flat = points.flat();
  const hasSide = forbidden === "left" || forbidden === "right";
  if (is_closed && hasSide && isInside(points_m, forbidden)) {
    pen.line(flat, { fill: colors.forbidden, fillAlpha: 0.14, isClosed: true });
  }
  if (hasSide) hatch(pen, size, is_closed ? [...points, points[0]] : points, forbidden === "left" ? 1 : -1, colors);
  pen.line(flat, { color: colors.surface, width: 2.5, isClosed: is_closed });
}

/// Whether the forbidden side of a closed polyline is its inside: the left one, if it runs counter-clockwise.
function isInside(points, forbidden) {
  const area = points.reduce((sum, [x, y], k) => {
    const [nx, ny] = points[(k + 1) % points.length];
    return sum + x * ny - nx * y;
  }, 0);
  return (area > 0) === (forbidden === "left");
}

/// Short strokes on the forbidden side. On the screen y points down, so left of (x, y) is (y, -x).
function hatch(pen, size, points, side, colors) {
  let left = HATCH.spacing / 2;
  const strokes = [];
  for (let k = 1; k < points.length; k += 1) {
    const [x, y] = points[k - 1], [nx, ny] = points[k];
    const length = Math.hypot(nx - x, ny - y);
    if (!(length > 0)) continue;
    const ux = (nx - x) / length, uy = (ny - y) / length;
    const acrossX = side * uy, acrossY = -side * ux;
    if (length > 1e6) continue;
    for (; left < length; left += HATCH.spacing) {
      const px = x + ux * left, py = y + uy * left;
      if (px < -20 || py < -20 || px > size.width + 20 || py > size.height + 20) continue;
      strokes.push(px, py, px + (acrossX - 0.6 * ux) * HATCH.length, py + (acrossY - 0.6 * uy) * HATCH.length, NaN, NaN);
    }
    left -= length;
  }
  pen.line(strokes, { color: colors.forbidden, width: 1.5 });
}

function drawPath(pen, place, records, index, style) {
  const flat = [], { path, first } = records;
  for (const point of path) {
    if (point.index > index) break;
    if (point.index >= first) flat.push(...place.to(point.x, point.y));
  }
  flat.push(...place.to(records.value("proxy_x_m", index), records.value("proxy_y_m", index)));
  pen.line(flat, style);
}

function drawArm(pen, place, { bases, elbows, wrist, tool }, colors) {
  const at = (point) => place.to(...point);
  const width = Math.max(3, Math.min(9, place.scale * 0.012));
  for (const k of [0, 1]) {
    pen.line([...at(elbows[k]), ...at(wrist)], { color: colors.distal, width: width * 0.7 });
    pen.line([...at(bases[k]), ...at(elbows[k])], { color: colors.proximal, width });
  }
  pen.line([...at(wrist), ...at(tool)], { color: colors.distal, width: width * 0.7 });
  for (const joint of elbows) pen.circle(...at(joint), width * 0.8, { color: colors.proximal, width: 2, fill: colors.panel });
  for (const base of bases) {
    const [x, y] = at(base);
    pen.circle(x, y, width * 1.3, { color: colors.proximal, width: 2, fill: colors.panel });
    pen.circle(x, y, width * 0.45, { fill: colors.proximal });
  }
  ["left", "right"].forEach((name, k) => {
    const [x, y] = at(bases[k]);
    pen.text(x, y + width * 1.3 + 15, name, { color: colors.muted, size: 12, anchor: "middle" });
  });
}

/// Draws the point at which the hand aims, and what the circle round the tool means.
function drawAim(pen, tool, [x, y], isHeld, yield_n, colors) {
  const color = isHeld ? colors.ink : colors.muted;
  pen.line([...tool, x, y], { color, width: 1.5, dash: [6, 4] });
  pen.circle(x, y, 7, { color, width: 2 });
  for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) pen.line([x + 4 * dx, y + 4 * dy, x + 11 * dx, y + 11 * dy], { color, width: 2 });
  if (yield_n > 0) pen.text(14, 22, `aim inside the circle: less than R = ${Number(yield_n.toPrecision(3))} N`, { color: colors.forceText, size: 12 });
}

/// `unit_n` is the force of an arrow of length `radius`, and `gap` the distance in pixels from the arrow to its number.
function drawForce(pen, [x, y], radius, [fx, fy], { unit_n: unit, yield_n }, gap, colors) {
  const force = Math.hypot(fx, fy);
  if (yield_n > 0) pen.circle(x, y, radius, { color: colors.force, width: 1.5, dash: [5, 4] });
  if (!(force > 0) || !Number.isFinite(x) || !Number.isFinite(force)) return;
  const length = Math.min(force / unit, LONGEST_ARROW) * radius;
  if (length < 2) return;
  const ux = fx / force, uy = -fy / force, head = Math.min(11, length * 0.5);
  const tip = [x + ux * length, y + uy * length], neck = [tip[0] - ux * head, tip[1] - uy * head];
  pen.line([x, y, ...neck], { color: colors.force, width: 3 });
  pen.line([...tip, neck[0] - uy * head * 0.5, neck[1] + ux * head * 0.5, neck[0] + uy * head * 0.5, neck[1] - ux * head * 0.5], { fill: colors.force, isClosed: true });
  if (length > 0.3 * radius) {
    const beyond = force / unit > LONGEST_ARROW ? "> " : "";
    pen.text(tip[0] + ux * gap, tip[1] + uy * gap + 4, `${beyond}${force.toFixed(1)} N`, { color: colors.forceText, size: 12, weight: 600, anchor: ux < -0.3 ? "end" : ux > 0.3 ? "start" : "middle" });
  }
}

/// Draws the other recording's record: its surfaces only if they differ from those below.
function drawOther(pen, place, { records, index, hasOwnSurfaces }, colors) {
  const value = (name) => records.value(name, index);
  if (hasOwnSurfaces) {
    const shift = shiftAt(records, index);
    for (const { points_m, is_closed } of records.machine.surfaces ?? []) {
      if (points_m.length > 1) pen.line(corners(place, points_m, shift).flat(), { color: colors.other, width: 2, dash: [8, 5], isClosed: is_closed });
    }
  }
  drawPath(pen, place, records, index, { color: colors.other, width: 1.5, dash: [6, 4] });
  const arm = posture(records, index);
  if (arm) {
    for (const k of [0, 1]) {
      pen.line([arm.bases[k], arm.elbows[k], arm.wrist].flatMap((point) => place.to(...point)), { color: colors.other, width: 1.5, dash: [3, 4] });
    }
  }
  const tool = records.isDevice ? place.to(value("reported_x_m"), value("reported_y_m")) : place.to(value("tool_x_m"), value("tool_y_m"));
  pen.circle(...tool, TOOL_RADIUS, { fill: colors.other });
  pen.circle(...place.to(value("proxy_x_m"), value("proxy_y_m")), PROXY_RADIUS, { color: colors.other, width: 2, dash: [4, 3] });
}

function drawScale(pen, size, place, colors) {
  const most = Math.min(160, size.width / 4) / place.scale;
  const power = 10 ** Math.floor(Math.log10(most));
  const length_m = power * [5, 2, 1].find((digit) => digit * power <= most);
  const x = 14, y = size.height - 14, width = length_m * place.scale;
  pen.line([x, y - 5, x, y, x + width, y, x + width, y - 5], { color: colors.muted, width: 1.5 });
  const name = length_m >= 1e-3 ? `${Number((length_m * 1000).toPrecision(3))} mm` : `${Number((length_m * 1e6).toPrecision(3))} \u00b5m`;
  pen.text(x + width / 2, y - 8, name, { color: colors.muted, size: 12, anchor: "middle" });
}
