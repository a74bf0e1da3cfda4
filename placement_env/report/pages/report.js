"use strict";
(function () {
  // Tables: a click on a heading sorts, another click turns the order round; cells without a number come last.
  document.querySelectorAll("table.sortable").forEach(function (table) {
    var headings = Array.from(table.tHead.rows[0].cells);
    headings.forEach(function (heading, column) {
      heading.firstElementChild.addEventListener("click", function () {
        var order = heading.getAttribute("aria-sort") === "ascending" ? "descending" : "ascending";
        headings.forEach(function (each) { each.removeAttribute("aria-sort"); });
        heading.setAttribute("aria-sort", order);
        var sign = order === "ascending" ? 1 : -1, numbers = heading.classList.contains("number");
        var rows = Array.from(table.tBodies[0].rows).map(function (row) {
          var cell = row.cells[column], value = cell.dataset.value;
          return { row: row, text: cell.textContent, number: value === undefined ? null : Number(value) };
        });
        rows.sort(function (a, b) {
          if (!numbers) return sign * a.text.localeCompare(b.text, "en", { numeric: true });
          if (a.number === null || b.number === null) return (a.number === null) - (b.number === null);
          return sign * (a.number - b.number);
        });
        rows.forEach(function (each) { table.tBodies[0].appendChild(each.row); });
      });
    });
  });

  // Tables wider than the page become cards.
  function fit() {
    document.querySelectorAll("table").forEach(function (table) {
      table.classList.remove("cards");
      table.classList.toggle("cards", table.offsetWidth > table.parentElement.clientWidth);
    });
  }
  window.addEventListener("resize", fit);
  fit();

  if (window.matchMedia("(max-width: 60rem)").matches) document.querySelector("nav details").open = false;
})();
