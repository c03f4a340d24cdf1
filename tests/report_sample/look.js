// Looks at every figure and heading of a report, takes one box off, and leaves what it saw as JSON.
addEventListener("load", () => {
  document.querySelectorAll("details").forEach(d => { d.removeAttribute("name"); d.open = true; });
  const seen = {empty: [], overlapping: [], small: []};
  const box = e => e.getBoundingClientRect();
  seen.width = innerWidth; seen.scroll = document.documentElement.scrollWidth;
  const figures = [...document.querySelectorAll("svg[role=img]")];
  seen.figures = figures.length;
  for (const svg of figures) {
    const name = svg.getAttribute("aria-label"), marks = svg.querySelectorAll("path,circle,image,rect:not(.hint)").length;
    if (marks < 3 || box(svg).width < 40 || box(svg).height < 20) seen.empty.push(name);
    const texts = [...svg.querySelectorAll("text")].map(t => ({words: t.textContent, r: box(t)}));
    const scale = box(svg).width / svg.viewBox.baseVal.width;
    for (const t of svg.querySelectorAll("text")) {
      const px = scale * parseFloat(t.getAttribute("font-size"));
      if (px < 9) seen.small.push(px.toFixed(1) + " px in " + name + ", " + svg.viewBox.baseVal.width + " wide");
    }
    for (let i = 0; i < texts.length; i++) for (let j = 0; j < i; j++) {
      const a = texts[i].r, b = texts[j].r;
      const x = Math.min(a.right, b.right) - Math.max(a.left, b.left), y = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
      if (x > 2 && y > 4) seen.overlapping.push(name + ": " + texts[i].words + " | " + texts[j].words);
    }
  }
  seen.headings = [...document.querySelectorAll("h1,h2,h3,h4,h5")].map(h => +h.tagName[1]);
  seen.heads_without_scope = document.querySelectorAll("thead th:not([scope])").length;
  const light = c => { const [r, g, b] = c.match(/\d+(\.\d+)?/g).map(Number).map(v => v / 255).map(v => v <= .03928 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4); return .2126 * r + .7152 * g + .0722 * b; };
  const style = getComputedStyle(document.body), two = [light(style.color), light(style.backgroundColor)].sort((a, b) => b - a);
  seen.contrast = (two[0] + .05) / (two[1] + .05);
  const shown = () => [...document.querySelectorAll(".curves path")].filter(p => getComputedStyle(p).display != "none").length;
  const choice = document.querySelector("#show-declared");
  seen.curves = [shown(), 0];
  if (choice) { choice.click(); seen.curves[1] = shown(); }
  const scrolls = e => e && (getComputedStyle(e).overflowX == "auto" || scrolls(e.parentElement));
  seen.beyond = [...document.querySelectorAll("main *")].filter(e => box(e).right > innerWidth + 1 && !scrolls(e.parentElement) && !scrolls(e)).slice(0, 5).map(e => e.tagName + "." + e.className);
  if (parent != window) { parent.postMessage(JSON.stringify(seen), "*"); return; }
  const out = document.createElement("pre"); out.id = "seen"; out.textContent = JSON.stringify(seen); document.body.append(out);
});
