// The documents of the API, as far as the page reads them.
export type Document = Record<string, any>;
export type Rgb = [number, number, number];
export type Range = [number, number];

export interface Component {
  label: string; structure: string; light_share: number; albedo: Rgb; color: Rgb;
  half_width_deg: number | null; alpha: number | null; kappa: number | null; f0: Rgb | null; f90: number | null;
  lobe: { theta_diff_deg: number[]; height: Rgb[] };
  ranges: { light_share: Range; albedo: Range[]; color: Range[]; half_width_deg: Range | null; alpha: Range | null; f0: Range[] | null };
  remarks?: string[];
}

export interface Fit {
  id: string; name: string | null; status: string; progress: number; measurement: string; likeness: string | null;
  options: Record<string, unknown>; metrics: Record<string, number | null> | null; created: string;
  error: { origin: "input" | "compute" | "system"; message: string } | null;
  warnings: string[]; components: Component[]; model: Document;
}

export interface Measurement { sha256: string; name: string | null; size: number; valid_nodes: number; created: string; fits: string[] }

// What a sphere and the plots show: a fit, its measurement, or both; `measured` is on a grid, `samples` is the
// address of those of a table.
export interface Subject { name: string; fit: string | null; measured: string | null; samples: string | null; labels: string[] }

export interface Curve { label: string; colour: string; x: number[]; y: (number | null)[]; dash?: string; points?: boolean; part?: boolean }
