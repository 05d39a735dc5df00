// Curves of a report that zoom. Without scripts, and on paper, the drawing stands in their place.
"use strict";
(() => {
  const FONT = "11px system-ui, sans-serif", STEP = 1.25;

  const ticks = (low, high, most) => { // about `most`, three at least
    const within = (step) => Math.floor(high / step + 1e-9) - Math.ceil(low / step - 1e-9) + 1;
    const raw = (high - low) / most, power = 10 ** Math.floor(Math.log10(raw));
    const steps = [10, 5, 2, 1, 0.5, 0.2, 0.1].map((n) => n * power), wide = steps.filter((n) => n >= raw).pop() || steps[0];
    const step = steps.find((n) => n <= wide && within(n) >= 3) || wide;
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push([k * step, (k * step).toFixed(digits)]);
    return found;
  };
  const first = (values, at) => { // index of the first value that is not below `at`
    let low = 0, high = values.length;
    while (low < high) { const mid = (low + high) >> 1; if (values[mid] < at) low = mid + 1; else high = mid; }
    return low;
  };

  // Draws `data` into the card of a figure; `renew` takes newer data, and keeps the part that is looked at.
  window.zoomable = (figure, data) => {
    const card = figure.querySelector(".card"), canvas = document.createElement("canvas"), told = document.createElement("p");
    const pen = canvas.getContext("2d");
    let whole = {}, start = {}, view = {}, INK, SOFT, GRID;
    const isMoved = (group) => view[group][0] !== start[group][0] || view[group][1] !== start[group][1];
    const measure = () => { // a part that was chosen stays
      const moved = Object.entries(view).filter(([group]) => isMoved(group));
      whole = {}; start = {}; view = {};
      for (const panel of data.panels) {
        const range = (whole[panel.group] ??= [Infinity, -Infinity]);
        for (const { x } of panel.curves) for (const v of x) if (v !== null) { range[0] = Math.min(range[0], v); range[1] = Math.max(range[1], v); }
        start[panel.group] ??= panel.x;
      }
      for (const group in whole) { // margins of the drawing belong to the whole
        whole[group] = [Math.min(whole[group][0], start[group][0]), Math.max(whole[group][1], start[group][1])];
        view[group] = [...start[group]];
      }
      for (const [group, [low, high]] of moved) set(group, low, high);
    };
    const across = (legend) => legend.reduce((sum, [label]) => sum + pen.measureText(label).width + 42, 0);
    const room = () => { // least width at which no words meet; a narrower card scrolls
      pen.font = FONT;
      const heads = data.panels.map((panel) => (pen.measureText(panel.title || "").width + across(panel.legend) + 24) / panel.box[2]);
      return data.themed ? 0 : Math.ceil(Math.max(480, across(data.legend) + 24, ...heads)); // a live page has its own width
    };
    let width = 0, height = 0, mouse = null, held = null;

    const frame = (panel) => ({ left: panel.box[0] * width, top: panel.box[1] * height, wide: panel.box[2] * width, high: panel.box[3] * height });
    const heights = (panel, [low, high]) => { // as drawn at first; else those of what is seen
      if (!isMoved(panel.group)) return panel.y;
      let least = Infinity, most = -Infinity;
      for (const { x, y } of panel.curves) {
        for (let k = Math.max(0, first(x, low) - 1); k < x.length && x[k] <= high; k++) if (y[k] !== null) { least = Math.min(least, y[k]); most = Math.max(most, y[k]); }
      }
      if (!(least <= most)) return panel.y;
      const margin = 0.06 * (most - least) || 0.5;
      return [least - margin, most + margin];
    };
    const line = (curve, low, high, px, py, columns) => {
      const { x, y } = curve, from = Math.max(0, first(x, low) - 1), to = Math.min(x.length, first(x, high) + 1);
      const bunch = Math.max(1, Math.floor((to - from) / (2 * columns)));
      let drawing = false, before = 0;
      pen.beginPath();
      for (let k = from; k < to; k += bunch) { // of each bunch the least and the greatest
        let least = null, most = null;
        for (let j = k; j < Math.min(k + bunch, to); j++) {
          if (y[j] === null || x[j] === null) continue;
          if (least === null || y[j] < y[least]) least = j;
          if (most === null || y[j] > y[most]) most = j;
        }
        if (least === null) { drawing = false; continue; }
        for (const j of least <= most ? [least, most] : [most, least]) {
          if (drawing && curve.look.steps) pen.lineTo(before, py(y[j]));
          before = px(x[j]);
          if (drawing) pen.lineTo(px(x[j]), py(y[j])); else pen.moveTo(px(x[j]), py(y[j]));
          drawing = true;
        }
      }
      stroke(curve.look);
    };
    const stroke = (look) => {
      pen.strokeStyle = look.colour; pen.globalAlpha = look.opacity; pen.lineWidth = 1.3 * look.width; pen.setLineDash(look.dash); pen.lineJoin = "round";
      if (look.width > 0) pen.stroke();
      pen.globalAlpha = 1; pen.setLineDash([]);
    };
    const write = (text, x, y, align, colour = SOFT) => { pen.fillStyle = colour; pen.textAlign = align; pen.fillText(text, x, y); };

    const name = (legend, from, y) => { // in a row that begins where `from` puts one of its width
      let at = from(12 + across(legend));
      for (const [label, look] of legend) {
        pen.beginPath(); pen.moveTo(at, y); pen.lineTo(at + 22, y); stroke(look);
        write(label, at + 27, y, "left", INK);
        at += pen.measureText(label).width + 42;
      }
    };

    const draw = () => {
      if (!width) return;
      const scale = window.devicePixelRatio || 1, own = getComputedStyle(card);
      [INK, SOFT, GRID] = [["--fg", "#1c1c1e"], ["--soft", "#5f6368"], ["--line", "#e4e4e8"]].map(([name, paper]) => data.themed ? own.getPropertyValue(name) : paper);
      canvas.width = width * scale; canvas.height = height * scale;
      pen.setTransform(scale, 0, 0, scale, 0, 0);
      pen.font = FONT; pen.textBaseline = "middle";
      name(data.legend, (wide) => Math.max(4, (width - wide) / 2), 10);
      for (const panel of data.panels) {
        const { left, top, wide, high } = frame(panel), [low, end] = view[panel.group], [bottom, upper] = heights(panel, view[panel.group]);
        const px = (v) => left + ((v - low) / (end - low)) * wide, py = (v) => top + high - ((v - bottom) / (upper - bottom)) * high;
        pen.lineWidth = 1; pen.strokeStyle = GRID;
        for (const [at, text] of ticks(low, end, Math.max(3, wide / 80))) {
          pen.beginPath(); pen.moveTo(px(at), top); pen.lineTo(px(at), top + high); pen.stroke();
          if (panel.ticks) write(text, px(at), top + high + 11, "center");
        }
        for (const [at, text] of ticks(bottom, upper, Math.max(3, high / 32))) {
          pen.beginPath(); pen.moveTo(left, py(at)); pen.lineTo(left + wide, py(at)); pen.stroke();
          write(text, left - 5, py(at), "right");
        }
        pen.save(); pen.beginPath(); pen.rect(left, top, wide, high); pen.clip();
        pen.fillStyle = "#8a8f9622";
        for (const [from, to] of panel.bands) pen.fillRect(px(from), top, px(to) - px(from), high);
        pen.strokeStyle = SOFT; pen.lineWidth = 0.7;
        for (const at of panel.rules) { pen.beginPath(); pen.moveTo(left, py(at)); pen.lineTo(left + wide, py(at)); pen.stroke(); }
        for (const curve of panel.curves) line(curve, low, end, px, py, wide);
        if (mouse && mouse.group === panel.group && mouse.x >= left && mouse.x <= left + wide) { pen.beginPath(); pen.moveTo(mouse.x, top); pen.lineTo(mouse.x, top + high); pen.strokeStyle = SOFT; pen.lineWidth = 0.7; pen.stroke(); }
        pen.restore();
        pen.strokeStyle = SOFT; pen.lineWidth = 1; pen.beginPath(); pen.moveTo(left, top); pen.lineTo(left, top + high); pen.lineTo(left + wide, top + high); pen.stroke();
        name(panel.legend, (long) => left + wide - long, top - 9);
        if (panel.title) write(panel.title, left, top - 9, "left", INK);
        if (panel.xlabel) write(panel.xlabel, left + wide / 2, top + high + 26, "center", INK);
        pen.save(); pen.translate(9, top + high / 2); pen.rotate(-Math.PI / 2);
        const words = panel.ylabel.split("\n"), shift = panel.box[0] > 0.3 ? left - 48 : 0;
        words.forEach((word, k) => write(word, 0, shift + 13 * k, "center", INK));
        pen.restore();
      }
    };

    const set = (group, low, high) => { // keeps within the whole
      const [least, most] = whole[group], span = Math.min(high - low, most - least);
      if (!(span > 1e-6 * (most - least))) return;
      low = Math.min(Math.max(low, least), most - span);
      view[group] = Math.abs(low - start[group][0]) + Math.abs(low + span - start[group][1]) < 1e-9 * span ? [...start[group]] : [low, low + span];
    };
    const scaleBy = (group, factor, share = 0.5) => {
      const [low, high] = view[group], at = low + share * (high - low);
      set(group, at - (at - low) * factor, at + (high - at) * factor);
    };
    const move = (group, share) => { const [low, high] = view[group], by = share * (high - low); set(group, low + by, high + by); };
    const all = (act) => { for (const group in view) act(group); draw(); };
    const reset = () => all((group) => { view[group] = [...start[group]]; });
    const under = (event) => {
      const box = canvas.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
      const panel = data.panels.find((each) => { const f = frame(each); return x >= f.left && x <= f.left + f.wide && y >= f.top - 14 && y <= f.top + f.high + 24; });
      return panel && { x, y, panel, group: panel.group, share: (x - frame(panel).left) / frame(panel).wide };
    };
    const tell = (here) => {
      mouse = here || null;
      if (!here) { told.textContent = HINT; return; }
      const [low, high] = view[here.group], at = low + here.share * (high - low);
      const said = here.panel.curves.filter((curve) => curve.label || here.panel.curves.length === 1).map(({ label, x, y }) => {
        let k = Math.min(first(x, at), x.length - 1);
        if (k > 0 && at - x[k - 1] < x[k] - at) k--;
        return `${label || here.panel.ylabel}: ${y[k] === null || y[k] === undefined ? "-" : Number(y[k].toPrecision(4))}`;
      });
      told.textContent = [`at ${Number(at.toPrecision(4))}`, ...said].join("; ");
    };

    canvas.addEventListener("wheel", (event) => {
      const here = under(event);
      if (!here || document.activeElement !== canvas) return; // the page scrolls
      event.preventDefault();
      scaleBy(here.group, event.deltaY > 0 ? STEP : 1 / STEP, here.share);
      draw();
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => { held = under(event); if (held) canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointermove", (event) => {
      const here = under(event);
      if (held) { move(held.group, (held.x - (event.clientX - canvas.getBoundingClientRect().left)) / frame(held.panel).wide); held.x = event.clientX - canvas.getBoundingClientRect().left; }
      tell(here);
      draw();
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { held = null; });
    canvas.addEventListener("pointerleave", () => { tell(null); draw(); });
    canvas.addEventListener("dblclick", reset);
    const keys = {
      "+": () => all((g) => scaleBy(g, 1 / STEP)), "=": () => all((g) => scaleBy(g, 1 / STEP)), "-": () => all((g) => scaleBy(g, STEP)),
      ArrowLeft: () => all((g) => move(g, -0.1)), ArrowRight: () => all((g) => move(g, 0.1)), 0: reset, Home: reset,
    };
    canvas.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || !keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });

    measure();
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${figure.querySelector("figcaption")?.textContent.trim() || "Curves"} ${HINT}`);
    told.className = "told";
    told.textContent = HINT;
    card.append(canvas, told);
    figure.classList.add("live");
    new ResizeObserver(() => {
      const wide = card.clientWidth - 2 * parseFloat(getComputedStyle(card).paddingLeft);
      const wanted = Math.max(wide, room());
      if (wide <= 0 || wanted === width) return;
      width = wanted; height = Math.max(260, width * data.size[1] / data.size[0]);
      canvas.style.width = `${width}px`; canvas.style.height = `${height}px`;
      draw();
    }).observe(card);
    return { renew: (newer) => { data = newer; measure(); draw(); } };
  };

  const HINT = "Click it, then: wheel, + or - zoom; drag or arrow keys move; double click, 0 or Home shows it as at first.";
  document.querySelectorAll("figure.zoom").forEach((figure) => window.zoomable(figure, JSON.parse(figure.querySelector("script").textContent)));
})();
