// One drawing, two outputs: a canvas for the screen and PNG, SVG text for files. Lengths are CSS pixels.

const FONT = "system-ui, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif";

export class CanvasPen {
  constructor(context) { this.context = context; }

  line(points, { color, width = 1, dash = [], alpha = 1, fill = null, fillAlpha = 1, isClosed = false }) {
    const { context } = this;
    context.beginPath();
    let isDown = false;
    for (let k = 0; k < points.length; k += 2) {
      if (!Number.isFinite(points[k]) || !Number.isFinite(points[k + 1])) { isDown = false; continue; }
      if (isDown) context.lineTo(points[k], points[k + 1]); else context.moveTo(points[k], points[k + 1]);
      isDown = true;
    }
    if (isClosed) context.closePath();
    this.paint(color, width, dash, alpha, fill, fillAlpha);
  }

  circle(x, y, radius, { color = null, width = 1, dash = [], alpha = 1, fill = null, fillAlpha = 1 }) {
    if (![x, y, radius].every(Number.isFinite)) return;
    this.context.beginPath();
    this.context.arc(x, y, radius, 0, 2 * Math.PI);
    this.paint(color, width, dash, alpha, fill, fillAlpha);
  }

  paint(color, width, dash, alpha, fill, fillAlpha) {
    const { context } = this;
    if (fill) {
      context.globalAlpha = fillAlpha;
      context.fillStyle = fill;
      context.fill();
    }
    if (color) {
      context.globalAlpha = alpha;
      context.strokeStyle = color;
      context.lineWidth = width;
      context.setLineDash(dash);
      context.lineCap = dash.length ? "butt" : "round";
      context.lineJoin = "round";
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  text(x, y, text, { color, size = 12, anchor = "start", weight = 400 }) {
    const { context } = this;
    context.font = `${weight} ${size}px ${FONT}`;
    context.textAlign = { start: "left", middle: "center", end: "right" }[anchor];
    context.textBaseline = "alphabetic";
    context.fillStyle = color;
    context.fillText(text, x, y);
  }

  box(x, y, width, height, fill) {
    this.context.fillStyle = fill;
    this.context.fillRect(x, y, width, height);
  }

  /// Draws within a box, with its corner as the origin.
  within(x, y, width, height, draw) {
    const { context } = this;
    context.save();
    context.beginPath();
    context.rect(x, y, width, height);
    context.clip();
    context.translate(x, y);
    draw(this);
    context.restore();
  }
}

const escaped = (text) => String(text).replace(/[&<>"]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[c]);
const short = (value) => Number(value.toFixed(2));

export class SvgPen {
  constructor() {
    this.parts = [];
    this.clips = 0;
  }

  line(points, style) {
    let path = "", isDown = false;
    for (let k = 0; k < points.length; k += 2) {
      if (!Number.isFinite(points[k]) || !Number.isFinite(points[k + 1])) { isDown = false; continue; }
      path += `${isDown ? "L" : "M"}${short(points[k])} ${short(points[k + 1])}`;
      isDown = true;
    }
    if (path) this.parts.push(`<path d="${path}${style.isClosed ? "Z" : ""}" ${this.paint(style)}/>`);
  }

  circle(x, y, radius, style) {
    if (![x, y, radius].every(Number.isFinite)) return;
    this.parts.push(`<circle cx="${short(x)}" cy="${short(y)}" r="${short(radius)}" ${this.paint(style)}/>`);
  }

  paint({ color = null, width = 1, dash = [], alpha = 1, fill = null, fillAlpha = 1 }) {
    const stroke = color ? `stroke="${color}" stroke-width="${width}" stroke-opacity="${alpha}" stroke-linecap="${dash.length ? "butt" : "round"}" stroke-linejoin="round"` : "";
    const dashes = color && dash.length ? ` stroke-dasharray="${dash.join(" ")}"` : "";
    return `fill="${fill ?? "none"}"${fill && fillAlpha < 1 ? ` fill-opacity="${fillAlpha}"` : ""} ${stroke}${dashes}`;
  }

  text(x, y, text, { color, size = 12, anchor = "start", weight = 400 }) {
    this.parts.push(`<text x="${short(x)}" y="${short(y)}" fill="${color}" font-size="${size}" font-weight="${weight}" text-anchor="${anchor}">${escaped(text)}</text>`);
  }

  box(x, y, width, height, fill) {
    this.parts.push(`<rect x="${short(x)}" y="${short(y)}" width="${short(width)}" height="${short(height)}" fill="${fill}"/>`);
  }

  within(x, y, width, height, draw) {
    this.clips += 1;
    const id = `clip${this.clips}`;
    this.parts.push(`<clipPath id="${id}"><rect width="${short(width)}" height="${short(height)}"/></clipPath>`);
    this.parts.push(`<g transform="translate(${short(x)} ${short(y)})" clip-path="url(#${id})">`);
    draw(this);
    this.parts.push("</g>");
  }

  /// The whole document.
  document(width, height, title) {
    return `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}" font-family="${FONT}">\n<title>${escaped(title)}</title>\n${this.parts.join("\n")}\n</svg>\n`;
  }
}
