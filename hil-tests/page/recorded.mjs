// Recordings of the program while a real browser looks on. Usage:
//   node recorded.mjs --program PATH --packages FOLDER --browser PATH

import { spawn } from "node:child_process";
import { createReadStream, mkdtempSync, readFileSync, rmSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { createInterface } from "node:readline";
import { parseArgs } from "node:util";
import { after, before, test } from "node:test";
import assert from "node:assert/strict";

const { values: given } = parseArgs({ options: Object.fromEntries(["program", "packages", "browser"].map((name) => [name, { type: "string" }])) });
const { chromium } = createRequire(join(resolve(given.packages), "package.json"))("playwright-core");
const folder = mkdtempSync(join(tmpdir(), "page-"));
const sleep = (time_ms) => new Promise((done) => { setTimeout(done, time_ms); });
let server, browser;

before(async () => {
  server = await chromium.launchServer({ executablePath: given.browser, args: ["--no-sandbox"] });
  browser = await chromium.connect(server.wsEndpoint());
});

after(async () => {
  await server?.close();
  rmSync(folder, { recursive: true });
});

/// Starts the program. `address` and `ended` wait for the address of its page and for its exit code.
function start(...words) {
  const child = spawn(given.program, words, { env: { ...process.env, XDG_STATE_HOME: folder }, stdio: ["ignore", "pipe", "pipe"] });
  const ended = new Promise((done) => { child.on("exit", done); });
  const address = new Promise((done, failed) => {
    let text = "";
    const read = (part) => {
      text += part;
      const found = text.match(/http:\S+(?=\s)/);
      if (found) done(found[0]);
    };
    [child.stdout, child.stderr].forEach((stream) => stream.on("data", read));
    ended.then((code) => failed(new Error(`${words.join(" ")} ended with ${code}: ${text}`)));
  });
  // A program without a page has no address.
  address.catch(() => {});
  return { child, ended, address };
}

async function opened(address) {
  const page = await (await browser.newContext()).newPage();
  await page.goto(address);
  await page.waitForFunction(() => window.yieldwall?.total > 100);
  return page;
}

test("a recording does not depend on a browser that stands still for 10 s and four that come and go", async (t) => {
  const run = (name, ...words) => start("--quiet", "run", "builtin:paper-admittance.yaml", "--duration", "45", "--record", join(folder, name), ...words);
  const viewed = run("viewed", "--view"), address = await viewed.address;
  const page = await opened(address);
  await page.evaluate(() => {
    let last = performance.now();
    window.longestGap = 0;
    setInterval(() => {
      window.longestGap = Math.max(window.longestGap, performance.now() - last);
      last = performance.now();
    }, 20);
  });
  // The process group of the browser: it neither reads nor answers.
  process.kill(-server.process().pid, "SIGSTOP");
  await sleep(10000);
  process.kill(-server.process().pid, "SIGCONT");
  const pages = await Promise.all([1, 2, 3].map(() => opened(address)));
  await Promise.all(pages.map((one) => one.context().close()));
  const total = await page.evaluate(() => window.yieldwall.total);
  await page.waitForFunction((before) => window.yieldwall.total > before + 200, total);
  const [gap_ms, stream] = await page.evaluate(() => [window.longestGap, document.getElementById("stream").innerText]);
  t.diagnostic(`${gap_ms.toFixed(0)} ms without a turn; ${stream.replaceAll("\n", " ")}`);
  assert.ok(gap_ms > 9000, `the browser stood still for ${gap_ms} ms`);
  assert.equal(await viewed.ended, 0);
  assert.equal(await run("alone").ended, 0);
  const [one, other] = ["viewed", "alone"].map((name) => readFileSync(join(folder, name, "cycles.mcap")));
  assert.ok(one.equals(other), `${one.length} and ${other.length} bytes`);
});

test("play: the energy that the page shows is that of the recording", async (t) => {
  const play = start("play", "--no-open", "--record", join(folder, "played"));
  const page = await opened(await play.address);
  await page.locator("label:has(> input[value=elastic])").click();
  await page.waitForFunction(() => window.yieldwall.play.law === "elastic" && window.yieldwall.total > 100);
  await page.locator("#scene").scrollIntoViewIfNeeded();
  const pixels = (point_m) => page.evaluate(([x, y]) => {
    const { left, top } = document.getElementById("scene").getBoundingClientRect(), at = window.yieldwall.toPixels(x, y);
    return [left + at[0], top + at[1]];
  }, point_m);
  const tool = await page.evaluate(() => ["tool_x_m", "tool_y_m"].map((name) => window.yieldwall.value(name)));
  await page.mouse.move(...(await pixels(tool)));
  await page.mouse.down();
  for (let k = 1; k <= 30; k += 1) {
    await page.mouse.move(...(await pixels([tool[0] - (k / 30) * (tool[0] + 0.06), tool[1]])));
    await sleep(30);
  }
  await page.waitForFunction(() => window.yieldwall.value("force_x_n") < -15);
  await page.mouse.up();
  await sleep(1500);
  const [last, energy_j] = await page.evaluate(() => window.yieldwall.energy);
  play.child.kill("SIGINT");
  assert.equal(await play.ended, 0);
  // The second run is that of the spring. Its text is read without the page's own decoder.
  let names, before = null, sum_j = 0, most_j = 0, index = -1;
  for await (const line of createInterface({ input: createReadStream(join(folder, "played", "2", "cycles.csv")) })) {
    const cells = line.split(",");
    if (!names) { names = cells; continue; }
    const now = Object.fromEntries(["index", "force_x_n", "force_y_n", "tool_x_m", "tool_y_m"].map((name) => [name, Number(cells[names.indexOf(name)])]));
    if (now.index > last) break;
    if (before) for (const axis of ["x", "y"]) sum_j += ((now[`force_${axis}_n`] + before[`force_${axis}_n`]) / 2) * (now[`tool_${axis}_m`] - before[`tool_${axis}_m`]);
    most_j = Math.max(most_j, sum_j);
    [before, index] = [now, now.index];
  }
  t.diagnostic(`${(1000 * energy_j).toFixed(3)} mJ on the page, ${(1000 * sum_j).toFixed(3)} mJ in the recording, at most ${(1000 * most_j).toFixed(1)} mJ`);
  assert.equal(index, last);
  assert.ok(most_j > 0.05 && Math.abs(energy_j - sum_j) < 1e-9 + 1e-6 * most_j, `${energy_j} and ${sum_j} J`);
});
