"use strict";
(() => {
  // The same script on every page. It reads what is shown, moves it, and adds words of its own: as text, never as markup.
  const narrow = "sort by";
  const add = (parent, name, className, text = "") => {
    const made = document.createElement(name);
    made.className = className;
    made.textContent = text;
    parent.append(made);
    return made;
  };

  // Tables: a click on a heading sorts the lines of each group, up, down, and as they were.
  const text = cell => (cell ? cell.dataset.order ?? cell.textContent.trim() : "");
  const number = shown => {
    if (shown.startsWith("\u221e")) return Infinity;
    const found = /^(?:< )?([+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?)/i.exec(shown);
    return found ? Number(found[1]) : NaN;
  };
  const compare = (column, down) => (a, b) => {
    const [one, other] = [text(a.cells[column]), text(b.cells[column])];
    const missing = (one === "-") - (other === "-");
    if (missing) return missing;
    const apart = column ? number(one) - number(other) : NaN;
    const order = Number.isNaN(apart) && one !== other ? one.localeCompare(other, "en", { numeric: true }) : apart || 0;
    return down ? -order : order;
  };
  for (const table of document.querySelectorAll("table.rows")) {
    const heads = [...table.tHead.rows[0].cells];
    const groups = [...table.tBodies].map(body => [body, [...body.rows].filter(row => !row.matches(".group"))]);
    if (!groups.some(([, rows]) => rows.length > 1)) continue;
    const sort = (column, way) => {
      heads.forEach((head, place) => {
        if (place === column && way) head.setAttribute("aria-sort", way);
        else head.removeAttribute("aria-sort");
      });
      for (const [body, rows] of groups) {
        body.append(...(way ? [...rows].sort(compare(column, way === "descending")) : rows));
      }
    };
    const label = document.createElement("label");
    label.className = "sorter";
    label.textContent = `${narrow} `;
    const choice = add(label, "select", "");
    add(choice, "option", "", "-").value = -1;
    heads.forEach((head, column) => {
      add(choice, "option", "", head.textContent).value = column;
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const now = head.getAttribute("aria-sort");
        sort(column, now === "ascending" ? "descending" : now ? "" : "ascending");
      });
    });
    choice.addEventListener("change", () => sort(Number(choice.value), Number(choice.value) < 0 ? "" : "ascending"));
    table.parentElement.before(label);
  }

  // Figures: what the pointer is at is marked in the figure and in the table, and said below the figure.
  const NEAR = 24; // px
  const repeated = document.getElementById("repeated");
  for (const frame of document.querySelectorAll(".spots")) {
    const spots = [...document.querySelectorAll("[data-at]")].filter(each => each.dataset.figure === frame.id);
    if (!spots.length) continue;
    const at = new Map(spots.map(each => [each, each.dataset.at.split(" ").map(Number)]));
    const rings = [add(frame, "span", "ring"), add(frame, "span", "ring small")];
    const tip = document.createElement("p");
    tip.className = "tip";
    tip.textContent = "Point at a mark or at a line of the table.";
    frame.closest("figure").append(tip);
    let active = null;
    const show = spot => {
      if (spot === active) return;
      if (active) active.classList.remove("on");
      active = spot;
      const places = spot ? at.get(spot) : [];
      rings.forEach((ring, k) => {
        ring.style.display = places.length > 2 * k ? "block" : "none";
        ring.style.left = `${places[2 * k]}%`;
        ring.style.top = `${places[2 * k + 1]}%`;
      });
      if (!spot) return;
      spot.classList.add("on");
      tip.textContent = spot.dataset.tip;
      if (repeated && spot.dataset.run) repeated.textContent = spot.dataset.run;
    };
    for (const spot of spots) {
      spot.addEventListener("pointerenter", () => show(spot));
      spot.addEventListener("pointerleave", () => show(null));
    }
    const nearest = event => {
      const box = frame.getBoundingClientRect();
      let best = null;
      let least = NEAR;
      for (const [spot, [x, y]] of at) {
        const [across, down] = [box.left + (x / 100) * box.width, box.top + (y / 100) * box.height];
        const distance = Math.hypot(event.clientX - across, event.clientY - down);
        if (distance < least) [best, least] = [spot, distance];
      }
      return best;
    };
    frame.addEventListener("pointermove", event => show(nearest(event)));
    frame.addEventListener("pointerleave", () => show(null));
    frame.addEventListener("click", event => {
      const spot = nearest(event);
      if (!spot) return;
      const closed = spot.closest("details");
      if (closed) closed.open = true;
      spot.scrollIntoView({ block: "center" });
      show(spot);
    });
  }
})();
