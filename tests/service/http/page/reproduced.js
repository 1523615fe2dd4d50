// What a page shows that its words do not tell, and what the functions of its modules return.
({
  restless: () => new Promise((done) => setTimeout(() => requestIdleCallback(done, { timeout: 100 }), 50))
    .then(() => !document.querySelector("#sign-in[open]") && document.querySelectorAll("[aria-busy=true], body.busy, [data-drawing]").length),
  drawn: () => ({
    plots: [...document.querySelectorAll("main .plot svg, main .legend svg")].map((svg) => ({
      label: svg.getAttribute("aria-label") ?? "", box: svg.getAttribute("viewBox"),
      paths: [...svg.querySelectorAll("path")].map((path) => `${path.getAttribute("class").trim()} ${path.getAttribute("d") ?? ""}`),
      texts: [...svg.querySelectorAll("text")].map((text) => `${text.textContent} ${text.getAttribute("text-anchor")} ${Number(text.getAttribute("x")).toFixed(1)} ${Number(text.getAttribute("y")).toFixed(1)}`),
    })),
    hidden: [...document.querySelectorAll("main [hidden]")].filter((part) => !part.parentElement.closest("[hidden]")).map((part) => part.id || part.className || part.dataset.act || part.name || part.tagName),
    fields: [...document.querySelectorAll("main :is(input, select)[name]")].filter((field) => !field.closest(".options")).map((field) => `${field.name} ${field.type === "checkbox" ? field.checked : field.value} ${field.min ?? ""} ${field.max ?? ""} ${field.step ?? ""}`),
    links: [...document.querySelectorAll("main a, main img, main canvas")].map((part) => `${part.tagName} ${part.title} ${part.getAttribute("href") ?? part.width}`),
    title: document.title,
  }),
  pixels: () => [...document.querySelectorAll("canvas")].filter((canvas) => !canvas.hidden && canvas.width > 1).map((canvas) => {
    const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
    copy.drawImage(canvas, 0, 0);
    const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
    const means = Array(20).fill(0); // There are means of 4 x 4 parts, then of the channels.
    const share = 16 / data.length / 255;
    data.forEach((value, i) => {
      const [x, y] = [Math.floor(i / 4) % canvas.width, Math.floor(i / 4 / canvas.width)];
      if (i % 4 < 3) means[4 * Math.floor((4 * y) / canvas.height) + Math.floor((4 * x) / canvas.width)] += (4 * share * value) / 3;
      means[16 + (i % 4)] += share * value / 4;
    });
    return means;
  }),
  functions: async () => {
    const [app, options, plots, result, shader, sphere] = await Promise.all(["app", "options", "plots", "result", "shader", "sphere"].map((name) => import(`/page/${name}.js`)));
    const texts = ["1", "1e-3", "none", "true", "false", "auto", "0,30,60", "value=signal,phi=x", "a b", "-9"];
    const progress = (steps) => {
      const { now } = performance;
      const said = app.progressOf("Sending");
      try {
        return steps.map(([seconds, done]) => { performance.now = () => 1000 * seconds; return said(done); });
      } finally { performance.now = now; }
    };
    const answers = async (...given) => {
      const asked = [];
      const send = async (address, { headers = {}, method = "GET", credentials } = {}) => {
        asked.push(`${method} ${new URL(address).pathname} ${JSON.stringify(headers)} ${credentials}`);
        const [status, content, more] = given.shift() ?? [0];
        if (!status) throw new Error("lost");
        return new Response(content, { status, headers: more });
      };
      const found = await app.request("v1/x", { headers: { Accept: "text/plain" } }, send).then((answer) => answer.text(), ({ title, message, status }) => `${title} | ${message} | ${status}`);
      return [found, ...asked, document.body.className];
    };
    const fit = { name: null, measurement: "0123456789abcdef", status: "running", progress: 0.999, likeness: null, metrics: null, started: null, created: "2026-01-02T03:04:05.678Z" };
    const states = [{}, { status: "accepted" }, { status: "failed" }, { status: "cancelled" }, { status: "succeeded" }, { likeness: "close (31.2 dB)" }, ...[0.0312, 0.25, 1].map((value) => ({ metrics: { relative_rms_expected: value } }))];
    const lobe = new Float32Array(3 * 64).map((_, i) => i);
    return {
      sizes: [0, 999, 12_345, 999_999, 1e6, 34_992_012, 2.5e9].map((size) => app.sizeOf({ size })),
      states: states.map((one) => app.stateOf({ ...fit, ...one })),
      names: [app.nameOf(fit), app.nameOf({ ...fit, name: "paint" }), app.dateOf(fit.created), app.madeOf(fit), app.madeOf({ ...fit, started: fit.created })],
      words: ["specular_lobe", "diffuse", "a_b_c"].map(app.words).concat(["n_lobes", "new_option"].map(app.titleOf), [true, false, null, "none", "auto", 3, [1, 2]].map(app.valueOf), app.sentenceOf("`a` is None or `b`.")),
      problems: ["There is no fit; GET /v1/fits lists your fits.", "a; b"].map((text) => { const { title, message, status } = new app.Problem(text); return [title, message, status]; }),
      progress: progress([[5, 0], [6, 0.01], [7, 0.1], [10, 0.5], [15, 0.995], [16, 1]]).concat(progress([[1, 0.5], [11, 0.51], [21, 0.75]])),
      answers: [await answers([200, "fine"]), await answers(), await answers([429, "", { "Retry-After": "0" }], [200, "after a pause"]), await answers(...Array(9).fill([429, '{"detail": "Too many."}', { "Retry-After": "0" }])), await answers([404, '{"detail": "Not here."}']), await answers([500, "no JSON"]), await answers([503, '{"detail": "Later.", "title": "Full"}'])],
      typed: options.typedOptions(texts.map((text, i) => [String(i), text])),
      cosines: [[0, 0, 0], [10, 30, 0], [10, 30, 180], [80, 60, 90], [45, 45, 45]].map(plots.cosines),
      below: await Promise.all([[[0, 0], [0, 0, 1]], [[0.3, -0.4], [-0.6, 0, 0.8]], [[0.9, 0.1], [-1, 0, 0]]].flatMap(([point, light]) => [{ fit: "a" }, { fit: null, measured: "b" }].map((one) => plots.valuesBelow(one, point, light)))),
      colours: [0, 0.01, 0.25, 0.5, 0.99, 1].map(shader.colourOf),
      exposure: [shader.exposureOf(lobe), shader.exposureOf(new Float32Array(12))],
      subjects: [null, { valid_nodes: 0 }, { valid_nodes: 9 }].map((stored) => result.subjectOf({ ...fit, id: "a", components: [] }, stored)),
      rows: [result.tableRow(["a", 1, ""]), result.tableRow(["", "b"], true), ...result.warningsOf(["One.", "Two."])].map((part) => part.outerHTML),
      panorama: sphere.panorama,
    };
  },
  // An upload whose progress and end are told at once.
  upload: (refused) => {
    window.told = [];
    window.XMLHttpRequest = class {
      upload = {};
      given = [];
      open(...words) { this.given.push(words.join(" ")); }
      setRequestHeader(...words) { this.given.push(words.join(": ")); }
      getResponseHeader() { return null; }
      abort() { this.onabort(new Error("given up")); }
      async send(body) {
        const tell = () => { window.told.push(`${document.querySelector("#sending-title").textContent} ${document.querySelector("progress").value}`); };
        for (const loaded of [0, 25, 80, 100]) { this.upload.onprogress({ loaded, total: 100 }); tell(); }
        window.told.push(...this.given, `${body.size} bytes`);
        [this.status, this.responseText] = [422, JSON.stringify({ detail: refused, title: "Wrong" })];
        this.onload();
      }
    };
  },
})
