// Filters the list by name while one types, and lets two fits be ticked for comparison.
const search = document.getElementById("search");
if (search) {
  const cards = [...document.querySelectorAll(".card")];
  const none = document.getElementById("no-match");
  search.addEventListener("input", () => {
    const wanted = search.value.trim().toLowerCase();
    for (const card of cards) card.hidden = !card.dataset.name.toLowerCase().includes(wanted);
    none.hidden = cards.some((card) => !card.hidden);
  });
  const boxes = [...document.querySelectorAll('input[name="fit"]')];
  const button = document.getElementById("compare-button");
  const update = () => {
    const ticked = boxes.filter((box) => box.checked).length;
    button.disabled = ticked !== 2;
    for (const box of boxes) box.disabled = ticked === 2 && !box.checked;
  };
  for (const box of boxes) box.addEventListener("change", update);
  update();
}
