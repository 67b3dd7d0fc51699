// Tables of class "filtered": a field that keeps the rows with all its words, and columns to sort by.
document.querySelectorAll("table.filtered").forEach((table) => {
  const body = table.tBodies[0];
  const rows = [...body.rows];
  const field = document.createElement("input");
  field.type = "search";
  field.placeholder = "Filter rows, such as: 12 joint sgan";
  field.setAttribute("aria-label", "Filter rows");
  field.className = "table-filter";
  table.parentElement.before(field);
  field.addEventListener("input", () => {
    const words = field.value.toLowerCase().split(/\s+/);
    for (const row of rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
    }
  });
  const number = (text) => (isNaN(parseFloat(text)) ? text : parseFloat(text));
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    const button = document.createElement("button");
    button.textContent = head.textContent;
    head.replaceChildren(button);
    let down = false;
    button.addEventListener("click", () => {
      const key = (row) => number(row.cells[column].textContent);
      rows.sort((a, b) => (key(a) > key(b) ? 1 : key(a) < key(b) ? -1 : 0) * (down ? -1 : 1));
      down = !down;
      head.setAttribute("aria-sort", down ? "ascending" : "descending");
      body.append(...rows);
    });
  });
});

// Tables of many columns, whose rows are lists on a phone: each cell knows its head.
document.querySelectorAll("article table:not(.filtered)").forEach((table) => {
  const heads = [...(table.tHead?.rows[0]?.cells ?? [])].map((head) => head.textContent.trim());
  if (heads.length < 5) return;
  table.dataset.wide = "";
  [...table.tBodies].flatMap((body) => [...body.rows]).forEach((row) => {
    [...row.cells].forEach((cell, column) => {
      cell.dataset.head = heads[column] ?? "";
      const content = document.createElement("span");
      content.append(...cell.childNodes);
      cell.append(content);
    });
  });
});

// Names in tables are broken behind an underscore, a slash or a dot.
document.querySelectorAll("article td code").forEach((code) => {
  [...code.childNodes].filter((node) => node.nodeType === Node.TEXT_NODE).forEach((text) => {
    const parts = text.data.split(/(?<=[_/.=])/);
    text.replaceWith(...parts.flatMap((part) => [part, document.createElement("wbr")]).slice(0, -1));
  });
});

// Numbers and their intervals stay in one line.
document.querySelectorAll('article td[style*="right"]').forEach((cell) => {
  cell.classList.toggle("number", cell.textContent.length < 14);
});

// Options are not broken at their hyphens.
document.querySelectorAll("article code").forEach((code) => {
  const walker = document.createTreeWalker(code, NodeFilter.SHOW_TEXT);
  const texts = [];
  while (walker.nextNode()) texts.push(walker.currentNode);
  texts.forEach((text) => {
    const parts = text.data.split(/((?<![^\s(])--?[A-Za-z][\w-]{0,24}(?![\w-]))/);
    if (parts.length < 2) return;
    text.replaceWith(...parts.map((part, place) => {
      if (place % 2 === 0) return part;
      const option = document.createElement("span");
      option.className = "whole";
      option.textContent = part;
      return option;
    }));
  });
});

// What programs print in columns keeps its lines: its letters are small enough for the window.
const aligned = [...document.querySelectorAll("article .highlight pre > code")].filter((code) =>
  code.textContent.split("\n").filter((line) => /\S {2,}\S.* {2,}\S/.test(line)).length > 1);
const fit = () => aligned.forEach((code) => {
  code.dataset.aligned = "";
  code.style.fontSize = code.style.paddingRight = "";
  const longest = Math.max(...code.textContent.split("\n").map((line) => line.length));
  const style = getComputedStyle(code);
  const room = code.clientWidth - 2 * parseFloat(style.paddingLeft);
  const size = room / (0.61 * longest);
  if (size < parseFloat(style.fontSize)) code.style.fontSize = `${size}px`;
  if (size < 1.2 * parseFloat(style.fontSize)) code.style.paddingRight = style.paddingLeft;
});
fit();
window.addEventListener("resize", fit);

// What the theme leaves without a name or out of reach of the keyboard.
document.querySelector(".md-search").setAttribute("aria-label", "Search");
document.querySelectorAll("th:empty").forEach((head) => {
  head.replaceWith(document.createElement("td"));
});
const complete = () => {
  document.querySelectorAll(".md-code__nav:not([aria-label])").forEach((nav) => {
    nav.setAttribute("aria-label", `Code ${nav.parentElement.id.replace(/\D/g, "")}`);
  });
  const wide = ".md-typeset__scrollwrap:not([tabindex]), .jp-OutputArea-output pre:not([tabindex])";
  document.querySelectorAll(wide).forEach((box) => {
    if (box.scrollWidth > box.clientWidth) box.tabIndex = 0;
  });
};
complete();
new MutationObserver(complete).observe(document.body, { childList: true, subtree: true });
