// The table of landings, filtered by world, fault and outcome; a count in the tables above shows its landings.
"use strict";

const form = document.querySelector(".filters");
const names = ["world", "fault", "outcome"];

function filter() {
  const wanted = Object.fromEntries(names.map((name) => [name, form.elements[name].value]));
  const rows = [...document.querySelectorAll(".landings tbody")];
  for (const row of rows) row.hidden = names.some((name) => wanted[name] && row.dataset[name] !== wanted[name]);
  form.querySelector("output").textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} landings`;
}

if (form) {
  form.hidden = false;
  form.addEventListener("input", filter);
  for (const link of document.querySelectorAll("a[data-outcome]")) {
    link.addEventListener("click", () => {
      for (const name of names) form.elements[name].value = link.dataset[name] ?? "";
      filter();
    });
  }
  filter();
}
