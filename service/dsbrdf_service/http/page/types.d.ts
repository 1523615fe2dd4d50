// The documents of the API, as far as the page reads them, and what its modules hand to each other: known everywhere.
type Rgb = [number, number, number];
type Interval = [number, number];

interface Component {
  label: string; light_share: number; albedo: Rgb; color: Rgb; remarks: string[];
  half_width_deg: number | null; surfaces: Surface[];
  lobe: { theta_diff_deg: number[]; height: Rgb[] };
  ranges: { light_share: Interval; albedo: Interval[]; color: Interval[] };
}

interface Surface { alpha: number | null; kappa: number | null; f0: Rgb | null; f90: number | null; alpha_range: Interval | null; f0_range: Interval[] | null }

interface Fit {
  id: string; name: string | null; status: string; progress: number; measurement: string; likeness: string | null;
  options: Record<string, unknown>; metrics: Record<string, number | null> | null; created: string;
  error: { origin: "input" | "compute" | "system"; message: string } | null;
  warnings: string[]; measure_next?: { theta_in_deg: number; theta_out_deg: number; phi_deg: number }[]; components: Component[]; model: { amplitude: number[][][]; center: number[][][] };
}

interface Measurement { sha256: string; name: string | null; size: number; valid_nodes: number; created: string; fits: string[] }

interface Table {
  n_rows: number; n_samples: number; columns: { name: string; read_as: string | null; unit: string }[]; ranges: Record<string, Interval>;
  angles_of_incidence: number[] | null; in_plane_of_incidence: number; warnings: string[]; first: number[][];
}

// What a sphere and the plots show: a fit, its measurement, or both. `measured` is on a grid; `samples` is the address of those of a table.
interface Subject { name: string; fit: string | null; measured: string | null; samples: string | null; parts: Component[] }

// Values by channel, then place; null where there is none.
type Channels = (number | null)[][];
// Of all that a plot shows along x; measured values may be at places of their own.
interface Values { x: number[]; fit: Channels | null; parts: Channels[]; measured: Channels | null; at: number[] }
interface Curve { label: string; colour: string; x: number[]; y: (number | null)[]; dash?: string; points?: boolean; part?: boolean; band?: Interval }
// Of a table: angles in degrees; theta_out is negative on the side of the light, `aside` is the way out of the plane of incidence.
interface Sample { half: number; diff: number; light: number; out: number; aside: number; values: number[] }

// A plot: its id; what its slider is called in the address, and begins the names of its choices; what it draws along which angle.
interface Plot {
  id: string; name: string; lead: string; title: string; axis: string; line: string; about: string;
  slider: { max: number; step: number; defaultValue: number }; along: "half" | "out"; start: number;
}
// What a plot draws, and how it is to look.
interface Drawing { all: Values[]; subjects: Subject[]; place: number; channel: string; axis: string; range: string }
// What the form of controls says; the highlight is the point of the sphere where the light's reflection is seen.
interface Look { show: string; lighting: string; stops: number; zoom: number; wipe: number; highlight: number[] }
interface Program { program: WebGLProgram; at: (name: string) => WebGLUniformLocation | null }
