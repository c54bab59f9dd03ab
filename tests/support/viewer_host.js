"use strict";
// Runs the script of a page (node viewer_host.js PAGE) against a stand-in for a browser; prints what it drew as JSON.
const page = require("fs").readFileSync(process.argv[2], "utf8");
const data = page.match(/<script type='application\/json' id='scene'>([\s\S]*?)<\/script>/)[1];
const code = page.match(/<script>\n([\s\S]*?)<\/script>/)[1];
let drawn;
const note = (kind, colour) => { drawn[kind + " " + colour] = (drawn[kind + " " + colour] || 0) + 1; };
const pen = {
  fillStyle: "", strokeStyle: "", lineWidth: 1, font: "",
  clearRect() { drawn = {}; },
  beginPath() {}, closePath() {}, arc() {},
  moveTo(x, y) { if (!Number.isFinite(x + y)) throw new Error("not a place"); },
  lineTo(x, y) { if (!Number.isFinite(x + y)) throw new Error("not a place"); },
  fill() { note("fill", this.fillStyle); },
  stroke() { note("stroke", this.strokeStyle); },
  fillText(said) { note("text", said); },
};
const values = { grow: "1", opacity: "0.6", frame: "0" };
const elements = {};
const make = (id) => ({
  style: {}, children: [], handlers: {}, value: values[id], textContent: id === "scene" ? data : "",
  clientWidth: 900, clientHeight: 480, width: 0, height: 0, checked: false,
  getContext: () => pen,
  addEventListener(name, act) { this.handlers[name] = act; },
  appendChild(child) { this.children.push(child); },
  getBoundingClientRect: () => ({ left: 0, top: 0, width: 900 }),
  setPointerCapture() {},
});
global.document = {
  getElementById(id) {
    if (!page.includes("id='" + id + "'")) throw new Error("the page has no " + id);
    return (elements[id] = elements[id] || make(id));
  },
  createElement: () => ({}),
};
global.window = { devicePixelRatio: 1, addEventListener() {} };
(0, eval)(code);
const before = drawn, figures = elements.figures.textContent, moment = elements.moment.textContent;
elements.after.checked = true;
elements.after.handlers.change();
const after = drawn, view = elements.view.handlers, tips = new Set();
view.pointerdown({ pointerId: 1, clientX: 0, clientY: 0 });
view.pointermove({ pointerId: 1, clientX: 40, clientY: 10 });
view.pointerup({ pointerId: 1 });
for (let x = 0; x < 900; x += 6) for (let y = 0; y < 480; y += 6) {
  view.pointermove({ pointerId: 1, clientX: x, clientY: y });
  if (elements.tip.style.display === "block") tips.add(elements.tip.textContent);
}
view.wheel({ deltaY: -200, preventDefault() {} });
const cases = elements.case.children.map((child) => child.textContent);
process.stdout.write(JSON.stringify({ before, after, figures, moment, tips: [...tips], cases }));
