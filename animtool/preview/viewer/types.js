/**
 * The records of the page's manifest, for the type checker alone.
 *
 * Units: metres, Y up, right-handed; quaternions x, y, z, w; colours 0…1 in sRGB. A number
 * that is called a stream is the id of one.
 *
 * @typedef {number[]} Vec
 * @typedef {{id: number, block: number[][], kind: 'i16'|'u8'|'u16'|'u32'|'f32', width: number,
 *   scale: number|number[], offset: number|number[], coding: 'delta'|'raw',
 *   gaps?: boolean}} Stream
 * @typedef {{t: Vec[], r: Vec[], s: Vec[]|null}} Locals
 * @typedef {{names: string[], weights: number}} ShapeTrack
 * @typedef {{joint: number, spans: number[][]}} Contact
 * @typedef {{name: string, skeleton: {names: string[], parents: number[], rest: Locals,
 *   tips?: number[][]}, moving: {t?: number[], r?: number[], s?: number[]}, still?: Locals|null,
 *   span?: number[], t?: number|null, r?: number|null, s?: number|null, shapes?: ShapeTrack|null,
 *   contacts?: Contact[], offset?: Vec, visible?: number|null}} TakeRecord
 * @typedef {{palette: number[], joints: number, weights: number, bind: number}} Skin
 * @typedef {{name: string, column: number, vertices: number, offsets: number}} Shape
 * @typedef {{name: string, take?: number|null, points: number, faces: number,
 *   skin?: Skin|null, shapes?: Shape[]|null, color?: Vec|null,
 *   colors?: number|null,
 *   cache?: number|null, prototype?: boolean, visible?: number|null}} MeshRecord
 * @typedef {{name: string, counts: number, points: number, width?: number, take?: number|null,
 *   joint?: number|null, bind?: number[]|null, color?: Vec|null}} StrandsRecord
 * @typedef {{name: string, positions: number, radius?: number, radii?: number|null,
 *   color?: Vec|null, colors?: number|null, names?: string[]|null}} PointsRecord
 * @typedef {{name: string, mesh: number, t: number, r: number, s?: number|null,
 *   visible?: number|null}} InstancesRecord
 * @typedef {{name: string, t: number, r: number, focal_mm: number,
 *   focal?: number|null, aperture_mm: Vec}} CameraRecord
 * @typedef {{name: string, unit: string, values: number, column?: number, keys?: number[][]|null,
 *   take?: number|null, moves?: number}} Channel
 * @typedef {{code: string, severity: string, message: string, frame?: number|null,
 *   joint?: string|null, take?: number|null}} Finding
 * @typedef {{format: number, title: string,
 *   source: {files: string[], unit: string, up: string},
 *   time: {first: number, step: number, count: number, rate: number[], label: string},
 *   errors?: {rotation_deg?: number, position_mm?: number}, streams: Stream[],
 *   takes?: TakeRecord[], meshes?: MeshRecord[], curves3d?: StrandsRecord[],
 *   points?: PointsRecord[], instances?: InstancesRecord[], cameras?: CameraRecord[],
 *   channels?: Channel[], findings?: Finding[], notices?: string[],
 *   watch?: {url: string, version: number}|null}} Manifest
 */

export {};
