// The area of a fluid's free surface on blocks of a grid, and its gradient.
#include "fluid/film.h"

#include <algorithm>
#include <cmath>

#include "base/groups.h"

namespace animtool::fluid {

using collide::Vec;

namespace {

// Cell size, in spacings: particles at rest are uniform to it, within a thousandth.
constexpr double CELL = 1.25;
// Colour gradients that count as zero, over a spacing: they have no area, and would blow thin fluid
// up.
constexpr double SOFT = 1e-3;
// Coordinates beyond this are in no cell [cells].
constexpr double FAR = 1e9;
// Cells that a particle may move before blocks are rebuilt.
constexpr std::int64_t ROOM = 1;
// Regularisation of the moments of inertia.
constexpr double THIN = 1e-9;

std::int64_t below(std::int64_t node, std::int64_t side) {
  return (node >= 0 ? node : node - side + 1) / side;
}

std::size_t mixed(std::int64_t x, std::int64_t y, std::int64_t z) {
  std::uint64_t h = static_cast<std::uint64_t>(x) * 0x9E3779B97F4A7C15u;
  h = (h ^ static_cast<std::uint64_t>(y)) * 0xC2B2AE3D27D4EB4Fu;
  h = (h ^ static_cast<std::uint64_t>(z)) * 0x165667B19E3779F9u;
  return static_cast<std::size_t>(h ^ (h >> 29));
}

}  // namespace

Film::Film(double spacing)
    : cell_(CELL * spacing), share_(1 / (CELL * CELL * CELL)), soft_(SOFT / spacing) {}

std::int32_t Film::block_at(std::int64_t x, std::int64_t y, std::int64_t z) const {
  const std::size_t mask = table_.size() - 1;
  for (std::size_t k = mixed(x, y, z) & mask;; k = (k + 1) & mask) {
    const std::int32_t block = table_[k];
    if (block <= 0) return 0;
    const auto& key = blocks_[static_cast<std::size_t>(block)];
    if (key[0] == x && key[1] == y && key[2] == z) return block;
  }
}

void Film::add_block(std::int64_t x, std::int64_t y, std::int64_t z) {
  if (block_at(x, y, z)) return;
  blocks_.push_back({x, y, z});
  if (4 * blocks_.size() > table_.size()) return grow();
  const std::size_t mask = table_.size() - 1;
  std::size_t k = mixed(x, y, z) & mask;
  while (table_[k]) k = (k + 1) & mask;
  table_[k] = static_cast<std::int32_t>(blocks_.size() - 1);
}

void Film::grow() {
  table_.assign(std::max<std::size_t>(8 * table_.size(), 1024), 0);
  const std::size_t mask = table_.size() - 1;
  for (std::size_t b = 1; b < blocks_.size(); ++b) {
    std::size_t k = mixed(blocks_[b][0], blocks_[b][1], blocks_[b][2]) & mask;
    while (table_[k]) k = (k + 1) & mask;
    table_[k] = static_cast<std::int32_t>(b);
  }
}

void Film::list(const double* rows, std::size_t count) {
  blocks_.assign(1, {0, 0, 0});
  std::fill(table_.begin(), table_.end(), 0);
  if (table_.empty()) grow();
  std::int64_t before[6] = {1, 0, 1, 0, 1, 0};
  for (std::size_t i = 0; i < count; ++i) {
    std::int64_t ends[6];
    bool same = true, near = true;
    for (int k = 0; k < 3; ++k) {
      const double at = rows[4 * i + static_cast<std::size_t>(k)] / cell_;
      near = near && std::fabs(at) < FAR;
      if (!near) break;
      // Its nodes, and those of the adjacent cells.
      const std::int64_t first = static_cast<std::int64_t>(std::floor(at)) - 1;
      ends[2 * k] = below(first - 1 - ROOM, SIDE);
      ends[2 * k + 1] = below(first + 4 + ROOM, SIDE);
      same = same && ends[2 * k] == before[2 * k] && ends[2 * k + 1] == before[2 * k + 1];
    }
    if (!near || same) continue;
    std::copy_n(ends, 6, before);
    for (std::int64_t x = ends[0]; x <= ends[1]; ++x)
      for (std::int64_t y = ends[2]; y <= ends[3]; ++y)
        for (std::int64_t z = ends[4]; z <= ends[5]; ++z) add_block(x, y, z);
  }
  const std::size_t size = blocks_.size();
  after_.assign(8 * size, 0);
  for (std::size_t b = 1; b < size; ++b)
    for (int k = 0; k < 8; ++k)
      after_[8 * b + static_cast<std::size_t>(k)] =
          block_at(blocks_[b][0] + (k >> 2), blocks_[b][1] + (k >> 1 & 1), blocks_[b][2] + (k & 1));
  part_drops();
  colour_.resize(NODES * size), rising_.resize(NODES * size), slopes_.resize(NODES * size);
}

bool Film::find(const double* row, Spot& spot) const {
  std::int64_t home[3];
  for (int k = 0; k < 3; ++k) {
    const double at = row[k] / cell_;
    if (!(std::fabs(at) < FAR)) return false;
    const double floor = std::floor(at), u = at - floor, v = 1 - u;
    const std::int64_t first = static_cast<std::int64_t>(floor) - 1;
    home[k] = below(first, SIDE);
    spot.node[k] = static_cast<int>(first - SIDE * home[k]);
    double *w = spot.weights[k], *s = spot.slopes[k];
    w[0] = v * v * v / 6, w[1] = (4 - 6 * u * u + 3 * u * u * u) / 6;
    w[2] = (4 - 6 * v * v + 3 * v * v * v) / 6, w[3] = u * u * u / 6;
    s[0] = -v * v / 2, s[1] = (3 * u - 4) * u / 2, s[2] = (4 - 3 * v) * v / 2, s[3] = u * u / 2;
  }
  const std::int32_t block = block_at(home[0], home[1], home[2]);
  if (!block) return false;
  std::copy_n(&after_[8 * static_cast<std::size_t>(block)], 8, spot.blocks);
  return true;
}

namespace {

// The four nodes of a row, from two adjacent blocks.
template <class Blocks>
void row_of(const Blocks& blocks, const int* node, int x, int y, std::size_t* at) {
  const int right = node[0] + x, up = node[1] + y;
  const std::size_t two = static_cast<std::size_t>((right >> 2) * 4 + (up >> 2) * 2);
  const std::size_t within = static_cast<std::size_t>(((right & 3) * 4 + (up & 3)) * 4);
  const std::size_t one = 64 * static_cast<std::size_t>(blocks[two]) + within;
  const std::size_t other = 64 * static_cast<std::size_t>(blocks[two + 1]) + within;
  for (int z = 0; z < 4; ++z) {
    const int deep = node[2] + z;
    at[z] = (deep < 4 ? one : other) + static_cast<std::size_t>(deep & 3);
  }
}

}  // namespace

double Film::measure(const double* rows, std::size_t count) {
  std::fill(colour_.begin(), colour_.end(), 0.0);
  std::fill(slopes_.begin(), slopes_.end(), 0.0);
  Spot spot;
  std::size_t at[4];
  for (std::size_t i = 0; i < count; ++i) {
    if (!find(rows + 4 * i, spot)) continue;
    for (int x = 0; x < 4; ++x)
      for (int y = 0; y < 4; ++y) {
        row_of(spot.blocks, spot.node, x, y, at);
        const double weight = share_ * spot.weights[0][x] * spot.weights[1][y];
        for (int z = 0; z < 4; ++z) colour_[at[z]] += weight * spot.weights[2][z];
      }
  }
  // The colour of sparse fluid rises at twice the rate, that of dense fluid not at all.
  for (std::size_t n = 0; n < colour_.size(); ++n) {
    const double left = std::max(1 - colour_[n], 0.0);
    rising_[n] = 2 * left;
    colour_[n] = 1 - left * left;
  }
  double sum = 0;
  for (std::size_t b = 1; b < blocks_.size(); ++b) sum += steepen(b);
  for (std::size_t n = 0; n < slopes_.size(); ++n) slopes_[n] *= rising_[n];
  return sum * cell_ * cell_ * cell_;
}

// Adds the gradient of the steepness of a block's cells by the colours of their nodes.
double Film::steepen(std::size_t block) {
  constexpr int X = WIDER * WIDER, Y = WIDER;
  double colours[X * WIDER], slopes[X * WIDER] = {};
  std::size_t from[X * WIDER];
  double most = 0, least = 2;
  int n = 0;
  for (int x = 0; x < WIDER; ++x)
    for (int y = 0; y < WIDER; ++y)
      for (int z = 0; z < WIDER; ++z, ++n) {
        const std::size_t of = static_cast<std::size_t>((x >> 2) * 4 + (y >> 2) * 2 + (z >> 2));
        const std::size_t node = static_cast<std::size_t>(((x & 3) * 4 + (y & 3)) * 4 + (z & 3));
        from[n] = NODES * static_cast<std::size_t>(after_[8 * block + of]) + node;
        colours[n] = colour_[from[n]];
        most = std::max(most, colours[n]), least = std::min(least, colours[n]);
      }
  if (most == least) return 0;
  const double quarter = 0.25 / cell_;
  double sum = 0;
  for (int x = 0; x < SIDE; ++x)
    for (int y = 0; y < SIDE; ++y)
      for (int z = 0; z < SIDE; ++z) {
        const int here = x * X + y * Y + z;
        const double* c = colours + here;
        // Along the four diagonals of the cell.
        const double p = c[X + Y + 1] - c[0], q = c[X + Y] - c[1], r = c[X + 1] - c[Y],
                     s = c[X] - c[Y + 1];
        const double gx = quarter * (p + q + r + s), gy = quarter * (p + q - r - s),
                     gz = quarter * (p - q + r - s);
        const double squared = gx * gx + gy * gy + gz * gz;
        if (!(squared > 0)) continue;
        const double steep = std::sqrt(squared + soft_ * soft_), over = quarter / steep;
        sum += steep - soft_;
        const double ux = gx * over, uy = gy * over, uz = gz * over;
        const double dp = ux + uy + uz, dq = ux + uy - uz, dr = ux - uy + uz, ds = ux - uy - uz;
        double* d = slopes + here;
        d[X + Y + 1] += dp, d[0] -= dp, d[X + Y] += dq, d[1] -= dq;
        d[X + 1] += dr, d[Y] -= dr, d[X] += ds, d[Y + 1] -= ds;
      }
  for (int k = 0; k < X * WIDER; ++k) slopes_[from[k]] += slopes[k];
  return sum;
}

Vec Film::slope_at(const Spot& spot) const {
  Vec sum;
  std::size_t at[4];
  for (int x = 0; x < 4; ++x)
    for (int y = 0; y < 4; ++y) {
      row_of(spot.blocks, spot.node, x, y, at);
      double along = 0, rising = 0;
      for (int z = 0; z < 4; ++z) {
        along += slopes_[at[z]] * spot.weights[2][z];
        rising += slopes_[at[z]] * spot.slopes[2][z];
      }
      sum.x += spot.slopes[0][x] * spot.weights[1][y] * along;
      sum.y += spot.weights[0][x] * spot.slopes[1][y] * along;
      sum.z += spot.weights[0][x] * spot.weights[1][y] * rising;
    }
  return sum;
}

void Film::pull(const double* rows, std::size_t count, double scale, double* moved) {
  Spot spot;
  // The volume of a cell, by its size and by the contribution of a particle.
  const double each = scale * cell_ * cell_ * share_;
  pulls_.assign(count, {}), drop_of_.assign(count, 0);
  for (std::size_t i = 0; i < count; ++i) {
    if (!find(rows + 4 * i, spot)) continue;
    pulls_[i] = slope_at(spot) * each;
    drop_of_[i] = drop_of_block_[static_cast<std::size_t>(spot.blocks[0])];
  }
  balance(rows);
  for (std::size_t i = 0; i < count; ++i) {
    double* out = moved + 4 * i;
    out[0] += pulls_[i].x, out[1] += pulls_[i].y, out[2] += pulls_[i].z;
  }
}

// Connected components of blocks: one drop each.
void Film::part_drops() {
  const std::size_t size = blocks_.size();
  Groups drops_of(size);
  for (std::size_t b = 1; b < size; ++b)
    for (const std::size_t k : {1, 2, 4})
      if (const std::int32_t next = after_[8 * b + k])
        drops_of.join(b, static_cast<std::size_t>(next));
  drop_of_block_.assign(size, 0);
  std::int32_t drops = 0;
  for (std::size_t b = 1; b < size; ++b) {
    const std::size_t from = drops_of.first_of(b);
    drop_of_block_[b] = from == b ? ++drops : drop_of_block_[from];
  }
  drops_.resize(static_cast<std::size_t>(drops) + 1);
}

// Removes net force and torque of the grid from each drop.
void Film::balance(const double* rows) {
  std::fill(drops_.begin(), drops_.end(), Drop());
  const auto drop_of = [&](std::size_t i) -> Drop& {
    return drops_[static_cast<std::size_t>(drop_of_[i])];
  };
  for (std::size_t i = 0; i < pulls_.size(); ++i) {
    Drop& drop = drop_of(i);
    if (!drop_of_[i]) continue;
    drop.count += 1;
    drop.centre = drop.centre + collide::load(rows + 4 * i), drop.push = drop.push + pulls_[i];
  }
  for (Drop& drop : drops_)
    if (drop.count > 0)
      drop.centre = drop.centre * (1 / drop.count), drop.push = drop.push * (1 / drop.count);
  for (std::size_t i = 0; i < pulls_.size(); ++i) {
    Drop& drop = drop_of(i);
    if (!drop_of_[i]) continue;
    const Vec off = collide::load(rows + 4 * i) - drop.centre;
    drop.moment = drop.moment + cross(off, pulls_[i]);
    double* m = drop.turning;
    m[0] += off.y * off.y + off.z * off.z, m[1] += off.x * off.x + off.z * off.z;
    m[2] += off.x * off.x + off.y * off.y;
    m[3] -= off.x * off.y, m[4] -= off.x * off.z, m[5] -= off.y * off.z;
  }
  for (Drop& drop : drops_) {
    double* m = drop.turning;
    // Particles on a line have no inertia about it.
    const double least = THIN * (m[0] + m[1] + m[2]);
    const double a = m[0] + least, b = m[1] + least, c = m[2] + least;
    const double d = m[3], e = m[4], f = m[5];
    const double aa = b * c - f * f, bb = a * c - e * e, cc = a * b - d * d;
    const double ab = e * f - d * c, ac = d * f - e * b, bc = d * e - a * f;
    const double whole = a * aa + d * ab + e * ac;
    const Vec by = drop.moment * (whole > 0 ? 1 / whole : 0.0);
    drop.moment = {aa * by.x + ab * by.y + ac * by.z, ab * by.x + bb * by.y + bc * by.z,
                   ac * by.x + bc * by.y + cc * by.z};
  }
  for (std::size_t i = 0; i < pulls_.size(); ++i) {
    const Drop& drop = drop_of(i);
    if (!drop_of_[i]) continue;
    const Vec off = collide::load(rows + 4 * i) - drop.centre;
    pulls_[i] = pulls_[i] - drop.push - cross(drop.moment, off);
  }
}

}  // namespace animtool::fluid
