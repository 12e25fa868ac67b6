// The area of a fluid's free surface on blocks of a grid, and its gradient.
#include "fluid/film.h"

#include <algorithm>
#include <cmath>

#include "base/groups.h"

namespace animtool::fluid {

using collide::Vec;

namespace {

// Cell size, in spacings: particles at rest are uniform on it, within a thousandth.
constexpr double CELL_SIZE_RATIO = 1.25;
// Colour gradients that count as zero, over a spacing: they have no area, and would otherwise blow
// up thin fluid.
constexpr double MIN_COLOUR_GRADIENT = 1e-3;
// Coordinates beyond this are in no cell [cells].
constexpr double MAX_CELL_COORDINATE = 1e9;
// Cells that a particle may cross before blocks are rebuilt.
constexpr std::int64_t MARGIN_CELLS = 1;
// Regularisation of the moments of inertia, over their sum.
constexpr double INERTIA_REGULARISATION = 1e-9;

// Index of the block of a node.
std::int64_t floor_divide(std::int64_t node, std::int64_t side) {
  return (node >= 0 ? node : node - side + 1) / side;
}

// Hash of a block's coordinates.
std::size_t hash_key(std::int64_t x, std::int64_t y, std::int64_t z) {
  std::uint64_t h = static_cast<std::uint64_t>(x) * 0x9E3779B97F4A7C15u;
  h = (h ^ static_cast<std::uint64_t>(y)) * 0xC2B2AE3D27D4EB4Fu;
  h = (h ^ static_cast<std::uint64_t>(z)) * 0x165667B19E3779F9u;
  return static_cast<std::size_t>(h ^ (h >> 29));
}

}  // namespace

FreeSurface::FreeSurface(double spacing)
    : cell_size_(CELL_SIZE_RATIO * spacing),
      inverse_volume_(1 / (CELL_SIZE_RATIO * CELL_SIZE_RATIO * CELL_SIZE_RATIO)),
      min_gradient_(MIN_COLOUR_GRADIENT / spacing) {}

std::int32_t FreeSurface::block_at(std::int64_t x, std::int64_t y, std::int64_t z) const {
  const std::size_t mask = block_table_.size() - 1;
  for (std::size_t k = hash_key(x, y, z) & mask;; k = (k + 1) & mask) {
    const std::int32_t block = block_table_[k];
    if (block <= 0) return 0;
    const auto& key = blocks_[static_cast<std::size_t>(block)];
    if (key[0] == x && key[1] == y && key[2] == z) return block;
  }
}

void FreeSurface::add_block(std::int64_t x, std::int64_t y, std::int64_t z) {
  if (block_at(x, y, z)) return;
  blocks_.push_back({x, y, z});
  if (4 * blocks_.size() > block_table_.size()) return grow_table();
  const std::size_t mask = block_table_.size() - 1;
  std::size_t k = hash_key(x, y, z) & mask;
  while (block_table_[k]) k = (k + 1) & mask;
  block_table_[k] = static_cast<std::int32_t>(blocks_.size() - 1);
}

void FreeSurface::grow_table() {
  block_table_.assign(std::max<std::size_t>(8 * block_table_.size(), 1024), 0);
  const std::size_t mask = block_table_.size() - 1;
  for (std::size_t b = 1; b < blocks_.size(); ++b) {
    std::size_t k = hash_key(blocks_[b][0], blocks_[b][1], blocks_[b][2]) & mask;
    while (block_table_[k]) k = (k + 1) & mask;
    block_table_[k] = static_cast<std::int32_t>(b);
  }
}

void FreeSurface::list_blocks(const double* rows, std::size_t count) {
  blocks_.assign(1, {0, 0, 0});
  std::fill(block_table_.begin(), block_table_.end(), 0);
  if (block_table_.empty()) grow_table();
  std::int64_t previous[6] = {1, 0, 1, 0, 1, 0};
  for (std::size_t i = 0; i < count; ++i) {
    std::int64_t block_range[6];
    bool is_same_block_range = true, is_finite = true;
    for (int k = 0; k < 3; ++k) {
      const double coordinate = rows[4 * i + static_cast<std::size_t>(k)] / cell_size_;
      is_finite = is_finite && std::fabs(coordinate) < MAX_CELL_COORDINATE;
      if (!is_finite) break;
      // Its nodes, and those of the adjacent cells.
      const std::int64_t first = static_cast<std::int64_t>(std::floor(coordinate)) - 1;
      block_range[2 * k] = floor_divide(first - 1 - MARGIN_CELLS, BLOCK_SIDE);
      block_range[2 * k + 1] = floor_divide(first + 4 + MARGIN_CELLS, BLOCK_SIDE);
      is_same_block_range = is_same_block_range && block_range[2 * k] == previous[2 * k] &&
                            block_range[2 * k + 1] == previous[2 * k + 1];
    }
    if (!is_finite || is_same_block_range) continue;
    std::copy_n(block_range, 6, previous);
    for (std::int64_t x = block_range[0]; x <= block_range[1]; ++x)
      for (std::int64_t y = block_range[2]; y <= block_range[3]; ++y)
        for (std::int64_t z = block_range[4]; z <= block_range[5]; ++z) add_block(x, y, z);
  }
  const std::size_t size = blocks_.size();
  neighbour_blocks_.assign(8 * size, 0);
  for (std::size_t b = 1; b < size; ++b)
    for (int k = 0; k < 8; ++k)
      neighbour_blocks_[8 * b + static_cast<std::size_t>(k)] =
          block_at(blocks_[b][0] + (k >> 2), blocks_[b][1] + (k >> 1 & 1), blocks_[b][2] + (k & 1));
  find_drops();
  colour_.resize(BLOCK_NODES * size), colour_rates_.resize(BLOCK_NODES * size),
      gradient_.resize(BLOCK_NODES * size);
}

bool FreeSurface::locate(const double* row, GridCell& cell) const {
  std::int64_t block_key[3];
  for (int k = 0; k < 3; ++k) {
    const double coordinate = row[k] / cell_size_;
    if (!(std::fabs(coordinate) < MAX_CELL_COORDINATE)) return false;
    const double floor = std::floor(coordinate), u = coordinate - floor, v = 1 - u;
    const std::int64_t first = static_cast<std::int64_t>(floor) - 1;
    block_key[k] = floor_divide(first, BLOCK_SIDE);
    cell.node[k] = static_cast<int>(first - BLOCK_SIDE * block_key[k]);
    double *w = cell.weights[k], *slopes = cell.slopes[k];
    w[0] = v * v * v / 6, w[1] = (4 - 6 * u * u + 3 * u * u * u) / 6;
    w[2] = (4 - 6 * v * v + 3 * v * v * v) / 6, w[3] = u * u * u / 6;
    slopes[0] = -v * v / 2, slopes[1] = (3 * u - 4) * u / 2, slopes[2] = (4 - 3 * v) * v / 2,
    slopes[3] = u * u / 2;
  }
  const std::int32_t block = block_at(block_key[0], block_key[1], block_key[2]);
  if (!block) return false;
  std::copy_n(&neighbour_blocks_[8 * static_cast<std::size_t>(block)], 8, cell.blocks);
  return true;
}

namespace {

// The four nodes of a row, from two adjacent blocks.
template <class Blocks>
void find_nodes(const Blocks& blocks, const int* node, int x, int y, std::size_t* nodes) {
  const int right = node[0] + x, up = node[1] + y;
  const std::size_t first_block = static_cast<std::size_t>((right >> 2) * 4 + (up >> 2) * 2);
  const std::size_t node_in_block = static_cast<std::size_t>(((right & 3) * 4 + (up & 3)) * 4);
  const std::size_t near_offset =
      64 * static_cast<std::size_t>(blocks[first_block]) + node_in_block;
  const std::size_t far_offset =
      64 * static_cast<std::size_t>(blocks[first_block + 1]) + node_in_block;
  for (int z = 0; z < 4; ++z) {
    const int depth = node[2] + z;
    nodes[z] = (depth < 4 ? near_offset : far_offset) + static_cast<std::size_t>(depth & 3);
  }
}

}  // namespace

double FreeSurface::compute_area(const double* rows, std::size_t count) {
  std::fill(colour_.begin(), colour_.end(), 0.0);
  std::fill(gradient_.begin(), gradient_.end(), 0.0);
  GridCell cell;
  std::size_t nodes[4];
  for (std::size_t i = 0; i < count; ++i) {
    if (!locate(rows + 4 * i, cell)) continue;
    for (int x = 0; x < 4; ++x)
      for (int y = 0; y < 4; ++y) {
        find_nodes(cell.blocks, cell.node, x, y, nodes);
        const double weight = inverse_volume_ * cell.weights[0][x] * cell.weights[1][y];
        for (int z = 0; z < 4; ++z) colour_[nodes[z]] += weight * cell.weights[2][z];
      }
  }
  // The colour of sparse fluid rises at twice the rate, that of dense fluid not at all.
  for (std::size_t n = 0; n < colour_.size(); ++n) {
    const double empty_fraction = std::max(1 - colour_[n], 0.0);
    colour_rates_[n] = 2 * empty_fraction;
    colour_[n] = 1 - empty_fraction * empty_fraction;
  }
  double sum = 0;
  for (std::size_t b = 1; b < blocks_.size(); ++b) sum += add_block_area(b);
  for (std::size_t n = 0; n < gradient_.size(); ++n) gradient_[n] *= colour_rates_[n];
  return sum * cell_size_ * cell_size_ * cell_size_;
}

// Returns the area in a block over a cell's volume; adds its gradient by the colours of the nodes.
double FreeSurface::add_block_area(std::size_t block) {
  constexpr int X_STRIDE = PADDED_SIDE * PADDED_SIDE, Y_STRIDE = PADDED_SIDE;
  double colours[X_STRIDE * PADDED_SIDE], block_gradient[X_STRIDE * PADDED_SIDE] = {};
  std::size_t node_indices[X_STRIDE * PADDED_SIDE];
  double largest = 0, smallest = 2;
  int n = 0;
  for (int x = 0; x < PADDED_SIDE; ++x)
    for (int y = 0; y < PADDED_SIDE; ++y)
      for (int z = 0; z < PADDED_SIDE; ++z, ++n) {
        const std::size_t neighbour =
            static_cast<std::size_t>((x >> 2) * 4 + (y >> 2) * 2 + (z >> 2));
        const std::size_t node = static_cast<std::size_t>(((x & 3) * 4 + (y & 3)) * 4 + (z & 3));
        node_indices[n] =
            BLOCK_NODES * static_cast<std::size_t>(neighbour_blocks_[8 * block + neighbour]) + node;
        colours[n] = colour_[node_indices[n]];
        largest = std::max(largest, colours[n]), smallest = std::min(smallest, colours[n]);
      }
  if (largest == smallest) return 0;
  const double gradient_scale = 0.25 / cell_size_;
  double sum = 0;
  for (int x = 0; x < BLOCK_SIDE; ++x)
    for (int y = 0; y < BLOCK_SIDE; ++y)
      for (int z = 0; z < BLOCK_SIDE; ++z) {
        const int offset = x * X_STRIDE + y * Y_STRIDE + z;
        const double* c = colours + offset;
        // Along the four diagonals of the cell.
        const double p = c[X_STRIDE + Y_STRIDE + 1] - c[0], q = c[X_STRIDE + Y_STRIDE] - c[1],
                     r = c[X_STRIDE + 1] - c[Y_STRIDE], s = c[X_STRIDE] - c[Y_STRIDE + 1];
        const double gx = gradient_scale * (p + q + r + s), gy = gradient_scale * (p + q - r - s),
                     gz = gradient_scale * (p - q + r - s);
        const double squared_gradient = gx * gx + gy * gy + gz * gz;
        if (!(squared_gradient > 0)) continue;
        const double magnitude = std::sqrt(squared_gradient + min_gradient_ * min_gradient_),
                     scale = gradient_scale / magnitude;
        sum += magnitude - min_gradient_;
        const double ux = gx * scale, uy = gy * scale, uz = gz * scale;
        const double dp = ux + uy + uz, dq = ux + uy - uz, dr = ux - uy + uz, ds = ux - uy - uz;
        double* d = block_gradient + offset;
        d[X_STRIDE + Y_STRIDE + 1] += dp, d[0] -= dp, d[X_STRIDE + Y_STRIDE] += dq, d[1] -= dq;
        d[X_STRIDE + 1] += dr, d[Y_STRIDE] -= dr, d[X_STRIDE] += ds, d[Y_STRIDE + 1] -= ds;
      }
  for (int k = 0; k < X_STRIDE * PADDED_SIDE; ++k) gradient_[node_indices[k]] += block_gradient[k];
  return sum;
}

Vec FreeSurface::compute_gradient(const GridCell& cell) const {
  Vec sum;
  std::size_t nodes[4];
  for (int x = 0; x < 4; ++x)
    for (int y = 0; y < 4; ++y) {
      find_nodes(cell.blocks, cell.node, x, y, nodes);
      double value = 0, derivative = 0;
      for (int z = 0; z < 4; ++z) {
        value += gradient_[nodes[z]] * cell.weights[2][z];
        derivative += gradient_[nodes[z]] * cell.slopes[2][z];
      }
      sum.x += cell.slopes[0][x] * cell.weights[1][y] * value;
      sum.y += cell.weights[0][x] * cell.slopes[1][y] * value;
      sum.z += cell.weights[0][x] * cell.weights[1][y] * derivative;
    }
  return sum;
}

void FreeSurface::add_tension(const double* rows, std::size_t count, double scale,
                              double* displacements) {
  GridCell cell;
  // The volume of a cell, over its size and the contribution of a particle.
  const double particle_scale = scale * cell_size_ * cell_size_ * inverse_volume_;
  tensions_.assign(count, {}), drop_of_particle_.assign(count, 0);
  for (std::size_t i = 0; i < count; ++i) {
    if (!locate(rows + 4 * i, cell)) continue;
    tensions_[i] = compute_gradient(cell) * particle_scale;
    drop_of_particle_[i] = drop_of_block_[static_cast<std::size_t>(cell.blocks[0])];
  }
  remove_net_forces(rows);
  for (std::size_t i = 0; i < count; ++i) {
    double* out = displacements + 4 * i;
    out[0] += tensions_[i].x, out[1] += tensions_[i].y, out[2] += tensions_[i].z;
  }
}

// Finds the connected components of blocks; each is a drop.
void FreeSurface::find_drops() {
  const std::size_t size = blocks_.size();
  Groups groups(size);
  for (std::size_t b = 1; b < size; ++b)
    for (const std::size_t k : {1, 2, 4})
      if (const std::int32_t neighbour = neighbour_blocks_[8 * b + k])
        groups.merge(b, static_cast<std::size_t>(neighbour));
  drop_of_block_.assign(size, 0);
  std::int32_t drop_count = 0;
  for (std::size_t b = 1; b < size; ++b) {
    const std::size_t root = groups.find_root(b);
    drop_of_block_[b] = root == b ? ++drop_count : drop_of_block_[root];
  }
  drops_.resize(static_cast<std::size_t>(drop_count) + 1);
}

// Removes the net force and torque of the grid from each drop.
void FreeSurface::remove_net_forces(const double* rows) {
  std::fill(drops_.begin(), drops_.end(), Drop());
  const auto drop_of = [&](std::size_t i) -> Drop& {
    return drops_[static_cast<std::size_t>(drop_of_particle_[i])];
  };
  for (std::size_t i = 0; i < tensions_.size(); ++i) {
    Drop& drop = drop_of(i);
    if (!drop_of_particle_[i]) continue;
    drop.count += 1;
    drop.centre = drop.centre + collide::load(rows + 4 * i),
    drop.mean_force = drop.mean_force + tensions_[i];
  }
  for (Drop& drop : drops_)
    if (drop.count > 0)
      drop.centre = drop.centre * (1 / drop.count),
      drop.mean_force = drop.mean_force * (1 / drop.count);
  for (std::size_t i = 0; i < tensions_.size(); ++i) {
    Drop& drop = drop_of(i);
    if (!drop_of_particle_[i]) continue;
    const Vec offset = collide::load(rows + 4 * i) - drop.centre;
    drop.angular_correction = drop.angular_correction + cross(offset, tensions_[i]);
    double* m = drop.inertia;
    m[0] += offset.y * offset.y + offset.z * offset.z,
        m[1] += offset.x * offset.x + offset.z * offset.z;
    m[2] += offset.x * offset.x + offset.y * offset.y;
    m[3] -= offset.x * offset.y, m[4] -= offset.x * offset.z, m[5] -= offset.y * offset.z;
  }
  for (Drop& drop : drops_) {
    double* m = drop.inertia;
    // Particles on a line have no inertia about it.
    const double regularisation = INERTIA_REGULARISATION * (m[0] + m[1] + m[2]);
    const double a = m[0] + regularisation, b = m[1] + regularisation, c = m[2] + regularisation;
    const double d = m[3], e = m[4], f = m[5];
    const double aa = b * c - f * f, bb = a * c - e * e, cc = a * b - d * d;
    const double ab = e * f - d * c, ac = d * f - e * b, bc = d * e - a * f;
    const double determinant = a * aa + d * ab + e * ac;
    const Vec scaled_moment = drop.angular_correction * (determinant > 0 ? 1 / determinant : 0.0);
    drop.angular_correction = {aa * scaled_moment.x + ab * scaled_moment.y + ac * scaled_moment.z,
                               ab * scaled_moment.x + bb * scaled_moment.y + bc * scaled_moment.z,
                               ac * scaled_moment.x + bc * scaled_moment.y + cc * scaled_moment.z};
  }
  for (std::size_t i = 0; i < tensions_.size(); ++i) {
    const Drop& drop = drop_of(i);
    if (!drop_of_particle_[i]) continue;
    const Vec offset = collide::load(rows + 4 * i) - drop.centre;
    tensions_[i] = tensions_[i] - drop.mean_force - cross(drop.angular_correction, offset);
  }
}

}  // namespace animtool::fluid
