// Figures: drawn when they come into view, and large when they are chosen; folded parts that a link leads into open.

const viewed = new IntersectionObserver(
  (entries) => {
    for (const { isIntersecting, target } of entries) {
      if (!isIntersecting) continue;
      viewed.unobserve(target);
      inflated(target.dataset.block).then((octets) => {
        target.src = URL.createObjectURL(new Blob([octets], { type: target.dataset.kind }));
      });
    }
  },
  { rootMargin: "600px" },
);
for (const image of document.querySelectorAll("img[data-block]")) viewed.observe(image);

const large = document.querySelector("dialog.large");
for (const button of document.querySelectorAll("figure button.enlarge")) {
  button.addEventListener("click", () => {
    const image = button.querySelector("img");
    large.querySelector("img").src = image.src;
    large.querySelector("img").alt = image.alt;
    large.querySelector("p").textContent = button.closest("figure").querySelector("figcaption").textContent;
    large.showModal();
  });
}
large?.addEventListener("click", (event) => {
  if (event.target.closest("img") === null) large.close();
});

if (matchMedia("(min-width: 42rem)").matches) {
  for (const folded of document.querySelectorAll("details.folded")) folded.open = true;
}

function unfold() {
  const target = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
  for (let element = target; element; element = element.parentElement) if (element.tagName === "DETAILS") element.open = true;
  target?.scrollIntoView();
}
addEventListener("hashchange", unfold);
if (location.hash) unfold();
