// Global types: documents of the API, as far as the page reads them, and values that modules exchange.
type Rgb = [number, number, number];
type Interval = [number, number];
type Format = (value: number, largest: number) => string;

interface Component {
  label: string; light_share: number; albedo: Rgb; color: Rgb; remarks: string[];
  half_width_deg: number | null; surfaces: Surface[];
  lobe: { theta_diff_deg: number[]; height: Rgb[] };
  ranges: { light_share: Interval; albedo: Interval[]; color: Interval[] };
}

interface Surface { alpha: number | null; tail_exponent: number | null; f0: Rgb | null; f70: Rgb | null; alpha_range: Interval | null; f0_range: Interval[] | null; f70_range: Interval[] | null }

interface Fit {
  id: string; name: string | null; status: string; progress: number; measurement: string; likeness: string | null;
  options: Record<string, unknown>; metrics: Record<string, number | null> | null; created: string; started: string | null;
  error: { origin: "input" | "compute" | "system"; message: string } | null;
  warnings: string[]; measure_next?: { theta_in_deg: number; theta_out_deg: number; phi_deg: number }[]; components: Component[]; model: { amplitude: number[][][]; center: number[][][] };
}

interface Measurement { sha256: string; name: string | null; size: number; valid_nodes: number; created: string; fits: string[] }

interface Table {
  n_rows: number; n_samples: number; columns: { name: string; read_as: string | null; unit: string }[]; ranges: Record<string, Interval>;
  angles_of_incidence_deg: number[] | null; in_plane_of_incidence: number; warnings: string[]; first: number[][];
}

// The subject of a sphere and its plots: a fit, its measurement, or both. `measured` is on a grid; `samples` is the address of a table's samples.
interface Subject { name: string; fit: string | null; measured: string | null; samples: string | null; parts: Component[] }

// Values by channel, then place; null where a value is missing.
type Channels = (number | null)[][];
// Values of a plot along x; measured values may have their own places.
interface Values { x: number[]; fit: Channels | null; parts: Channels[]; measured: Channels | null; at: number[] }
interface Curve { label: string; colour: string; x: number[]; y: (number | null)[]; dash?: string; points?: boolean; part?: boolean; band?: Interval }
// A sample of a table, with angles in degrees; theta_out is negative on the light's side, `aside` is the angle to the plane of incidence.
interface Sample { half: number; diff: number; light: number; out: number; aside: number; values: number[] }

// A plot: its id; the name of its slider in the address, also the prefix of its choices; its curves and the angle along them.
interface Plot {
  id: string; name: string; lead: string; title: string; axis: string; line: string; about: string;
  slider: { max: number; step: number; defaultValue: number }; along: "half" | "out"; start: number;
}
// The content and the style of a plot.
interface Drawing { all: Values[]; subjects: Subject[]; place: number; channel: string; axis: string; range: string }
// The state of the form of controls; the highlight is the point of the light's reflection on the sphere.
interface Look { show: string; lighting: string; stops: number; zoom: number; wipe: number; highlight: number[] }
interface Program { program: WebGLProgram; at: (name: string) => WebGLUniformLocation | null }
