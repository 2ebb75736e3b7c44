// Filter of the claims by verdict and by words.

function startClaims(root) {
  const rows = [...root.querySelectorAll(".claim")];
  const buttons = [...root.querySelectorAll("[data-filter]")];
  const search = root.querySelector("input[type=search]");
  const count = root.querySelector("[role=status]");

  function filter() {
    const verdict = buttons.find((button) => button.getAttribute("aria-pressed") === "true").dataset.filter;
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    for (const row of rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = (verdict !== "all" && row.dataset.verdict !== verdict) || !words.every((w) => text.includes(w));
    }
    const left = rows.filter((row) => !row.hidden).length;
    count.textContent = left === rows.length ? `all ${left} claims` : `${left} of ${rows.length} claims`;
  }

  for (const button of buttons) {
    button.addEventListener("click", () => {
      for (const other of buttons) other.setAttribute("aria-pressed", String(other === button));
      filter();
    });
  }
  search.addEventListener("input", filter);
}

document.querySelectorAll(".claims").forEach(startClaims);
