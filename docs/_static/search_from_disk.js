// Pages that are opened from a disk cannot be fetched: their texts come from a script instead.
if (location.protocol === "file:") {
  const script = document.createElement("script");
  script.src = "_static/search_pages.js";
  const loaded = new Promise((resolve) => script.addEventListener("load", resolve));
  document.head.append(script);
  const folder = new URL(".", location.href).href;
  window.fetch = async (address) => {
    await loaded;
    const page = new URL(address, location.href).href.slice(folder.length).split(/[?#]/)[0];
    return new Response(searchPages[page] ?? "");
  };
}
