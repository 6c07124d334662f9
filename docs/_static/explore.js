// The page "Explore": JNDs of a straight taper, read from the table of the perfect cone.
const source = document.getElementById("explore-table");
if (source) explore(JSON.parse(source.textContent));

function explore(table) {
  const find = (id) => document.getElementById(id);
  const count = table.last.length;
  const angles = table.arc[0].length;
  const clamp = (value, top) => Math.min(Math.max(value, 0), top - 1.000001);

  // Between the rows: distances and angles stand at sines of equal steps.
  function contact(u, theta) {
    const x = ((Math.asin(u) * 2) / Math.PI - 0.005) / 0.99 * (count - 1);
    if (x > count - 1) return null;
    const i = Math.floor(clamp(x, count));
    const f = Math.max(x - i, 0);
    const last = table.last[i] + f * (table.last[i + 1] - table.last[i]);
    const share = theta / last;
    if (share > 0.999) return null;
    const y = ((Math.asin(share) * 2) / Math.PI - 0.005) / 0.994 * (angles - 1);
    const j = Math.floor(clamp(y, angles));
    const g = y - j;
    const read = (name) => {
      const [a, b] = [table[name][i], table[name][i + 1]];
      return (1 - f) * ((1 - g) * a[j] + g * a[j + 1]) + f * ((1 - g) * b[j] + g * b[j + 1]);
    };
    return { read, last };
  }

  function settings() {
    const value = (name) => Number(find(`x-${name}`).value);
    const [length, base, ratio] = [value("length") * 1e-3, value("base") * 1e-6, value("ratio")];
    const taper = 1 - 1 / ratio;
    return {
      length, base, ratio, taper, apex: length / taper, k: value("k"), r: value("r") * length,
      theta: (value("angle") * Math.PI) / 180, noise: find("x-noise").value,
      stiffness: (3.34e9 * Math.PI * base ** 4) / 4,
    };
  }

  // JND of the force map, m; null where the whisker has flicked past or slipped off its tip.
  function mapped(s, r, theta) {
    const at = contact(r / s.apex, theta);
    if (!at || at.read("arc") > s.taper) return null;
    return { jnd: s.k * s.apex * at.read(s.noise), at };
  }

  function say(s) {
    find("o-length").value = `${(s.length * 1e3).toFixed(0)} mm`;
    find("o-base").value = `${(s.base * 1e6).toFixed(0)} µm`;
    find("o-ratio").value = s.ratio.toFixed(1);
    find("o-k").value = s.k.toFixed(2);
    find("o-angle").value = `${((s.theta * 180) / Math.PI).toFixed(0)}°`;
    find("o-r").value = `${(s.r * 1e3).toFixed(1)} mm`;
    const tap = s.k * s.r * (1 - s.r / s.apex);
    const found = mapped(s, s.r, s.theta);
    const mm = (x) => `${(x * 1e3).toFixed(2)} mm`;
    let text = `At ${mm(s.r)} the JND of a light tap is ${mm(tap)}, and ${mm(s.k * s.r)} with a cylinder. `;
    if (found) {
      const u = s.r / s.apex; // the table has signals over their small-angle forms
      const moment = (found.at.read("moment") * 3 * s.theta * (1 - u) / u * s.stiffness) / s.apex;
      const axial = (found.at.read("axial") * 1.5 * s.theta ** 2 * (3 - 2 * u) / u ** 2 * s.stiffness) / s.apex ** 2;
      text += `The force map's is ${mm(found.jnd)}: moment ${+(moment * 1e6).toPrecision(3)} µN m, ` +
        `axial force ${+(axial * 1e6).toPrecision(3)} µN, contact angle ${(found.at.read("contact_angle") * s.theta * 180 / Math.PI).toFixed(0)}°.`;
    } else {
      text += "At this angle the whisker has flicked past or slipped off its tip.";
    }
    find("explore-says").textContent = text;
  }

  function canvas(id) {
    const element = find(id);
    const width = element.clientWidth;
    const height = Math.round(width * 0.75);
    const dense = window.devicePixelRatio || 1;
    element.width = width * dense;
    element.height = height * dense;
    element.style.height = `${height}px`;
    const pen = element.getContext("2d");
    pen.scale(dense, dense);
    const style = getComputedStyle(document.documentElement);
    pen.fillStyle = pen.strokeStyle = style.getPropertyValue("--pst-color-text-base") || "#222";
    pen.font = "12px sans-serif";
    const box = { left: 52, top: 12, right: width - 12, bottom: height - 40 };
    return { pen, box, x: (v) => box.left + v * (box.right - box.left), y: (v) => box.bottom - v * (box.bottom - box.top) };
  }

  function axes({ pen, box, x, y }, xs, ys, names) {
    pen.lineWidth = 1;
    pen.beginPath();
    pen.moveTo(box.left, box.top);
    pen.lineTo(box.left, box.bottom);
    pen.lineTo(box.right, box.bottom);
    pen.stroke();
    pen.textAlign = "center";
    for (const [at, text] of xs) pen.fillText(text, x(at), box.bottom + 16);
    pen.fillText(names[0], (box.left + box.right) / 2, box.bottom + 34);
    pen.textAlign = "right";
    for (const [at, text] of ys) pen.fillText(text, box.left - 5, y(at) + 4);
    pen.save();
    pen.translate(13, (box.top + box.bottom) / 2);
    pen.rotate(-Math.PI / 2);
    pen.textAlign = "center";
    pen.fillText(names[1], 0, 0);
    pen.restore();
  }

  const steps = (top, unit) => {
    const step = 10 ** Math.floor(Math.log10(top / 2));
    const size = [1, 2, 5].map((n) => n * step).find((n) => top / n <= 6) || 10 * step;
    return Array.from({ length: Math.floor(top / size + 1e-9) + 1 }, (_, n) => [(n * size) / top, `${+(n * size).toPrecision(3)}${unit}`]);
  };

  function curve(s) {
    const chart = canvas("explore-curve");
    const top = s.k * s.length * 1.02;
    const { pen, x, y, box } = chart;
    axes(chart, steps(s.length * 1e3, ""), steps(top * 1e3, ""), ["radial distance (mm)", "JND (mm)"]);
    const lines = [
      ["tap, taper", "#0072B2", [], (r) => s.k * r * (1 - r / s.apex)],
      ["tap, cylinder", "#D55E00", [7, 4], (r) => s.k * r],
      ["force map", "#009E73", [2, 3], (r) => mapped(s, r, s.theta)?.jnd ?? NaN],
    ];
    lines.forEach(([name, colour, dash, value], n) => {
      pen.strokeStyle = colour;
      pen.lineWidth = 2;
      pen.setLineDash(dash);
      pen.beginPath();
      let down = false;
      for (let p = 1; p < 200; p++) {
        const v = value((p / 200) * s.length) / top;
        if (!(v <= 1)) { down = false; continue; }
        pen[down ? "lineTo" : "moveTo"](x(p / 200), y(v));
        down = true;
      }
      pen.moveTo(box.left + 12, box.top + 10 + 16 * n);
      pen.lineTo(box.left + 40, box.top + 10 + 16 * n);
      pen.stroke();
      pen.setLineDash([]);
      pen.textAlign = "left";
      pen.fillText(name, box.left + 46, box.top + 14 + 16 * n);
    });
  }

  function surface(s) {
    const chart = canvas("explore-map");
    const { pen, x, y, box } = chart;
    const most = Math.PI / 2;
    const cells = [80, 60];
    const rows = [];
    for (let a = 0; a < cells[0]; a++) {
      for (let b = 0; b < cells[1]; b++) {
        const found = mapped(s, ((a + 0.5) / cells[0]) * s.length, ((b + 0.5) / cells[1]) * most);
        if (found) rows.push([a, b, found.jnd / (s.k * s.length)]);
      }
    }
    const top = Math.max(...rows.map((row) => row[2]));
    const ink = pen.fillStyle;
    pen.fillStyle = "#fff";
    pen.fillRect(box.left, box.top, box.right - box.left, box.bottom - box.top);
    const [w, h] = [(box.right - box.left) / cells[0] + 0.6, (box.bottom - box.top) / cells[1] + 0.6];
    for (const [a, b, value] of rows) {
      const share = value / top; // from dark blue over grey to yellow, as cividis
      pen.fillStyle = `rgb(${Math.round(253 * share)}, ${Math.round(32 + 199 * share)}, ${Math.round(77 + 40 * Math.sin(Math.PI * share) - 10 * share)})`;
      pen.fillRect(x(a / cells[0]), y((b + 1) / cells[1]), w, h);
    }
    pen.fillStyle = ink;
    axes(chart, steps(s.length * 1e3, ""), steps(90, "°"), ["radial distance (mm)", "deflection angle"]);
    pen.beginPath();
    pen.arc(x(s.r / s.length), y(s.theta / most), 6, 0, 2 * Math.PI);
    pen.lineWidth = 5;
    pen.strokeStyle = "#fff";
    pen.stroke();
    pen.lineWidth = 2;
    pen.strokeStyle = "#D55E00";
    pen.stroke();
  }

  function draw() {
    const s = settings();
    say(s);
    curve(s);
    surface(s);
  }
  find("explore").addEventListener("input", draw);
  window.addEventListener("resize", draw);
  new MutationObserver(draw).observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
  draw();
}
