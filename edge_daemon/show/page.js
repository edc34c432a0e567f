// Keeps the page fresh: fetches the named texts and puts them in place; reloads when rows have come or gone.
"use strict";

const EVERY_MS = 1000;
const cells = new Map([...document.querySelectorAll("[data-name]")].map((cell) => [cell.dataset.name, cell]));
const contact = document.getElementById("contact");
let lastContact = Date.now();

function show(texts) {
  for (const [name, [text, mood]] of Object.entries(texts)) {
    const cell = cells.get(name);
    if (!cell) continue;
    if (cell.textContent !== text) cell.textContent = text;
    cell.dataset.mood = mood;
  }
}

async function refresh() {
  try {
    const answer = await fetch("/api/state", { cache: "no-store", signal: AbortSignal.timeout(5 * EVERY_MS) });
    const page = (await answer.json()).page;
    if (page.layout !== document.body.dataset.layout) {
      location.reload();
      return;
    }
    show(page.texts);
    lastContact = Date.now();
    contact.hidden = true;
  } catch {
    contact.textContent = `No contact with the gateway for ${Math.round((Date.now() - lastContact) / 1000)} s: the numbers below are old.`;
    contact.hidden = false;
  }
  setTimeout(refresh, EVERY_MS);
}

setTimeout(refresh, EVERY_MS);
