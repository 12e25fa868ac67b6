// N-body gravity: direct sums, or a tree of cells.
//
// References:
//     J. Barnes, P. Hut, A hierarchical O(N log N) force-calculation algorithm, Nature 324,
//     1986. J. Barnes, A modified tree code: don't laugh; it runs, Journal of Computational
//     Physics 87, 1990 (one walk for a group of bodies). J. K. Salmon, M. S. Warren,
//     Skeletons from the treecode closet, Journal of Computational Physics 111, 1994 (cells
//     are opened by a bound of their error).
#include "particles/gravity.h"

#include <cmath>
#include <vector>

#include "base/checks.h"
#include "base/keys.h"
#include "particles/gravity_lanes.h"
#include "particles/particles.h"

namespace animtool {

namespace {

// Largest number of bodies in a leaf cell, and in a group that traverses the tree together.
constexpr std::size_t MAX_LEAF_BODIES = 16, MAX_GROUP_BODIES = 128;
// Levels of the tree: three coordinates of this many bits fit a key of 63 bits.
constexpr unsigned TREE_LEVELS = 21;
// Opening ratio of the coarse sum that estimates accelerations: distance over radius.
constexpr double COARSE_OPENING_RATIO = 1.4;
// Error budget of one cell: hundreds of errors partly cancel, and bounds are rarely reached.
// Calibrated on discs, spheres and pairs of both.
constexpr double CELL_ERROR_BUDGET = 0.3;

// A cell of the tree: its bodies in sorted order, their moments, and the next cell after its
// subtree.
struct Cell {
  double centre[3];
  double mass;
  double moments[6];
  double squared_radius;  // square of the largest distance from the centre
  double max_mass;        // largest mass of one body
  double error_moment;    // sum of mass times cubed distance, to the power of 2/5
  std::size_t begin, end, next;
  bool is_leaf;
};

// Bodies in units in which lengths and masses are of order 1, to stay in the range of float32.
class Bodies {
 public:
  Bodies(const double* points, const double* masses, std::size_t count, double softening)
      : count_(count) {
    double low[3], high[3], total_mass = 0;
    for (std::size_t k = 0; k < 3; ++k) low[k] = high[k] = points[k];
    for (std::size_t i = 0; i < count; ++i) {
      for (std::size_t k = 0; k < 3; ++k) {
        low[k] = std::min(low[k], points[3 * i + k]);
        high[k] = std::max(high[k], points[3 * i + k]);
      }
      total_mass += masses[i];
    }
    double size = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      centre_[k] = low[k] + (high[k] - low[k]) / 2;
      size = std::max(size, (high[k] - low[k]) / 2);
    }
    // Scales by powers of two, which is exact.
    length_unit_ = std::exp2(std::ceil(std::log2(size > 0 ? size : 1)));
    mass_unit_ = std::exp2(std::ceil(std::log2(total_mass > 0 ? total_mass : 1)));
    const double scaled_softening = softening / length_unit_;
    squared_softening_ = scaled_softening * scaled_softening;
    for (auto& column : columns_) column = block<double>(count);
  }

  void fill_columns(const double* points, const double* masses, const std::int32_t* order) {
    for (std::size_t i = 0; i < count_; ++i) {
      const std::size_t body = order ? static_cast<std::size_t>(order[i]) : i;
      for (std::size_t k = 0; k < 3; ++k) columns_[k][i] = scale(points + 3 * body, k);
      columns_[3][i] = masses[body] / mass_unit_;
    }
  }

  // Component k of a point in scaled units.
  double scale(const double* point, std::size_t k) const {
    return (point[k] - centre_[k]) / length_unit_;
  }
  GravityBodies bodies() const {
    return {columns_[0].get(), columns_[1].get(), columns_[2].get(), columns_[3].get()};
  }
  const double* column(std::size_t k) const { return columns_[k].get(); }
  std::size_t size() const { return count_; }
  double squared_softening() const { return squared_softening_; }

  // Targets from `first`, padded with the last one.
  GravityTargets targets(std::size_t first, std::size_t end, const double* centre) const {
    GravityTargets targets;
    for (std::size_t k = 0; k < GRAVITY_WIDTH; ++k) {
      const std::size_t i = std::min(first + k, end - 1);
      targets.x[k] = columns_[0][i], targets.y[k] = columns_[1][i], targets.z[k] = columns_[2][i];
      targets.mass[k] = columns_[3][i];
      for (std::size_t axis = 0; axis < 3; ++axis)
        targets.from_centre[axis][k] = static_cast<float>(columns_[axis][i] - centre[axis]);
    }
    return targets;
  }

  double* acceleration;
  double* potential;
  double* max_squared_frequency;

  // Writes sums in the original units and order.
  void write(const GravitySums& sums, std::size_t first, std::size_t end, const std::int32_t* order,
             double constant) const {
    const double acceleration_scale = constant * mass_unit_ / length_unit_ / length_unit_;
    for (std::size_t i = first; i < std::min(first + GRAVITY_WIDTH, end); ++i) {
      const std::size_t k = i - first, body = order ? static_cast<std::size_t>(order[i]) : i;
      acceleration[3 * body] = acceleration_scale * sums.x[k];
      acceleration[3 * body + 1] = acceleration_scale * sums.y[k];
      acceleration[3 * body + 2] = acceleration_scale * sums.z[k];
      potential[body] = -acceleration_scale * length_unit_ * sums.potential[k];
      max_squared_frequency[body] =
          acceleration_scale / length_unit_ * sums.max_squared_frequency[k];
    }
  }

 private:
  std::size_t count_;
  double centre_[3], length_unit_, mass_unit_, squared_softening_;
  Block<double> columns_[4];
};

// An octree over bodies sorted by Morton keys; cells are in depth-first order.
class Octree {
 public:
  Octree(Bodies& bodies, const double* points, const double* masses)
      : bodies_(bodies), sorted_(bodies.size()) {
    const std::size_t count = bodies.size();
    constexpr double CELLS_PER_AXIS = 1 << TREE_LEVELS;
    for (std::size_t i = 0; i < count; ++i) {
      std::uint64_t key = 0;
      for (std::size_t k = 0; k < 3; ++k) {
        const double cell = (bodies.scale(points + 3 * i, k) + 1) * (CELLS_PER_AXIS / 2);
        key |= spread_bits(static_cast<std::uint64_t>(std::clamp(cell, 0.0, CELLS_PER_AXIS - 1)))
               << k;
      }
      sorted_.keys[i] = key;
      sorted_.indices[i] = static_cast<std::int32_t>(i);
    }
    sort_keys(sorted_, count);
    bodies.fill_columns(points, masses, sorted_.indices.get());
    cells_.reserve(count / 4 + 64);
    build(0, count, 0);
  }

  const std::int32_t* order() const { return sorted_.indices.get(); }

  template <class Function>
  void for_each_group(Function function) const {
    for (std::size_t i = 0; i < cells_.size();) {
      const Cell& cell = cells_[i];
      const bool is_group = cell.is_leaf || cell.end - cell.begin <= MAX_GROUP_BODIES;
      if (is_group) function(cell);
      i = is_group ? cell.next : i + 1;
    }
  }

  // The bounds and centre of a group.
  struct Bounds {
    double low[3], high[3], centre[3];

    double squared_distance(const double* point) const {
      double sum = 0;
      for (std::size_t k = 0; k < 3; ++k) {
        const double distance = std::max({low[k] - point[k], point[k] - high[k], 0.0});
        sum += distance * distance;
      }
      return sum;
    }
  };
  Bounds bounds(const Cell& group) const {
    Bounds bounds;
    for (std::size_t k = 0; k < 3; ++k) {
      const double* coordinates = bodies_.column(k);
      const auto [low, high] =
          std::minmax_element(coordinates + group.begin, coordinates + group.end);
      bounds.low[k] = *low, bounds.high[k] = *high;
      bounds.centre[k] = (*low + *high) / 2;
    }
    return bounds;
  }

  // Estimates the acceleration of a group by a coarse sum at its centre of mass.
  double estimate_acceleration(const Cell& group) const {
    const double softening_square = bodies_.squared_softening();
    double sum[3] = {0, 0, 0};
    for (std::size_t i = 0; i < cells_.size();) {
      const Cell& cell = cells_[i];
      double offset[3], squared_distance = 0;
      for (std::size_t k = 0; k < 3; ++k) {
        offset[k] = cell.centre[k] - group.centre[k];
        squared_distance += offset[k] * offset[k];
      }
      const bool is_in_group = cell.begin >= group.begin && cell.end <= group.end;
      if (!is_in_group && !cell.is_leaf &&
          squared_distance <= COARSE_OPENING_RATIO * COARSE_OPENING_RATIO * cell.squared_radius) {
        ++i;
        continue;
      }
      if (!is_in_group && squared_distance > 0) {
        const double softened_square = squared_distance + softening_square,
                     factor = cell.mass / (softened_square * std::sqrt(softened_square));
        for (std::size_t k = 0; k < 3; ++k) sum[k] += factor * offset[k];
      }
      i = cell.next;
    }
    const double external_acceleration =
        std::sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]);
    const double squared_extent = group.squared_radius + softening_square;
    // The heaviest body, which dominates the others, is attracted only by the rest.
    return external_acceleration +
           (squared_extent > 0 ? (group.mass - group.max_mass) / squared_extent : 0.0);
  }

  // Collects the cells that a group may use as a whole, and the ranges of bodies that it sums
  // directly.
  void traverse(const Bounds& bounds, double threshold, std::vector<float>& far_cells,
                std::vector<BodyRange>& near_runs) const {
    const double softening_square = bodies_.squared_softening();
    far_cells.clear();
    near_runs.clear();
    for (std::size_t i = 0; i < cells_.size();) {
      const Cell& cell = cells_[i];
      const double squared_distance = bounds.squared_distance(cell.centre);
      const bool has_several_bodies = cell.end - cell.begin > 1;
      if (has_several_bodies && squared_distance > cell.squared_radius &&
          cell.error_moment <= threshold * (squared_distance + softening_square)) {
        for (std::size_t k = 0; k < 3; ++k)
          far_cells.push_back(static_cast<float>(cell.centre[k] - bounds.centre[k]));
        far_cells.push_back(static_cast<float>(cell.mass));
        for (const double moment : cell.moments) far_cells.push_back(static_cast<float>(moment));
      } else if (!cell.is_leaf) {
        ++i;
        continue;
      } else if (!near_runs.empty() && near_runs.back().end == cell.begin) {
        near_runs.back().end = cell.end;
      } else {
        near_runs.push_back({cell.begin, cell.end});
      }
      i = cell.next;
    }
  }

 private:
  static std::uint64_t spread_bits(std::uint64_t x) {
    x = (x | x << 32) & 0x1f00000000ffff;
    x = (x | x << 16) & 0x1f0000ff0000ff;
    x = (x | x << 8) & 0x100f00f00f00f00f;
    x = (x | x << 4) & 0x10c30c30c30c30c3;
    return (x | x << 2) & 0x1249249249249249;
  }

  void build(std::size_t begin, std::size_t end, unsigned level) {
    const std::size_t cell = cells_.size();
    cells_.push_back(create_cell(begin, end));
    cells_[cell].is_leaf = end - begin <= MAX_LEAF_BODIES || level == TREE_LEVELS;
    if (!cells_[cell].is_leaf) {
      const unsigned shift = 3 * (TREE_LEVELS - 1 - level);
      const std::uint64_t* keys = sorted_.keys.get();
      for (std::size_t first = begin; first < end;) {
        const std::uint64_t last = (keys[first] >> shift << shift) + (1ull << shift);
        const std::size_t next =
            static_cast<std::size_t>(std::lower_bound(keys + first, keys + end, last) - keys);
        build(first, next, level + 1);
        first = next;
      }
    }
    cells_[cell].next = cells_.size();
  }

  Cell create_cell(std::size_t begin, std::size_t end) const {
    const auto [x, y, z, mass] = bodies_.bodies();
    Cell cell{};
    cell.begin = begin, cell.end = end;
    double mean[3] = {0, 0, 0};
    for (std::size_t i = begin; i < end; ++i) {
      const double position[3] = {x[i], y[i], z[i]};
      cell.mass += mass[i];
      cell.max_mass = std::max(cell.max_mass, mass[i]);
      for (std::size_t k = 0; k < 3; ++k) {
        cell.centre[k] += mass[i] * position[k];
        mean[k] += position[k];
      }
    }
    for (std::size_t k = 0; k < 3; ++k)
      cell.centre[k] =
          cell.mass > 0 ? cell.centre[k] / cell.mass : mean[k] / static_cast<double>(end - begin);
    double error_moment = 0;
    for (std::size_t i = begin; i < end; ++i) {
      const double a = x[i] - cell.centre[0], b = y[i] - cell.centre[1];
      const double c = z[i] - cell.centre[2], m = mass[i];
      const double squared = a * a + b * b + c * c;
      const double products[6] = {a * a, a * b, a * c, b * b, b * c, c * c};
      for (std::size_t k = 0; k < 6; ++k) cell.moments[k] += m * products[k];
      cell.squared_radius = std::max(cell.squared_radius, squared);
      error_moment += m * squared * std::sqrt(squared);
    }
    cell.error_moment = std::pow(error_moment, 0.4);
    return cell;
  }

  Bodies& bodies_;
  SortedKeys sorted_;
  std::vector<Cell> cells_;
};

// Sums gravity by the tree, or over all pairs.
void sum_by_tree(Bodies& bodies, const double* points, const double* masses, double constant,
                 double accuracy, const GravityFunctions& gravity_functions) {
  const Octree tree(bodies, points, masses);
  std::vector<float> far_cells;
  std::vector<BodyRange> near_runs;
  const float softening_square = static_cast<float>(bodies.squared_softening());
  tree.for_each_group([&](const Cell& group) {
    const auto bounds = tree.bounds(group);
    const double threshold =
        std::pow(CELL_ERROR_BUDGET * accuracy * tree.estimate_acceleration(group), 0.4);
    tree.traverse(bounds, threshold, far_cells, near_runs);
    for (std::size_t first = group.begin; first < group.end; first += GRAVITY_WIDTH) {
      const GravityTargets targets = bodies.targets(first, group.end, bounds.centre);
      GravitySums sums{};
      gravity_functions.sum_cells(far_cells.data(), far_cells.size() / FAR_CELL_SIZE,
                                  softening_square, targets, sums);
      for (const BodyRange& run : near_runs)
        gravity_functions.sum_pairs_float(bodies.bodies(), run, bodies.squared_softening(), targets,
                                          sums);
      bodies.write(sums, first, group.end, tree.order(), constant);
    }
  });
}

void sum_directly(Bodies& bodies, const double* points, const double* masses, double constant,
                  const GravityFunctions& gravity_functions) {
  // Blocks of sources that stay in the cache for all targets.
  constexpr std::size_t SOURCE_TILE_SIZE = 1024;
  bodies.fill_columns(points, masses, nullptr);
  const double centre[3] = {0, 0, 0};
  const std::size_t count = bodies.size();
  const std::size_t block_count = (count + GRAVITY_WIDTH - 1) / GRAVITY_WIDTH;
  const Block<GravitySums> sums = block<GravitySums>(block_count);
  std::fill_n(sums.get(), block_count, GravitySums{});
  for (std::size_t tile = 0; tile < count; tile += SOURCE_TILE_SIZE)
    for (std::size_t i = 0; i < block_count; ++i)
      gravity_functions.sum_pairs_double(
          bodies.bodies(), {tile, std::min(count, tile + SOURCE_TILE_SIZE)},
          bodies.squared_softening(), bodies.targets(i * GRAVITY_WIDTH, count, centre), sums[i]);
  for (std::size_t i = 0; i < block_count; ++i)
    bodies.write(sums[i], i * GRAVITY_WIDTH, count, nullptr, constant);
}

}  // namespace

std::tuple<Out<double, 2>, Out<double, 1>, Out<double, 1>> gravity(In<double, 2> points,
                                                                   In<double, 1> masses,
                                                                   double constant,
                                                                   double softening,
                                                                   double accuracy) {
  const std::size_t count = check::points("points", points);
  check::shape("masses", masses, {count});
  check::finite("points", points);
  check::finite("masses", masses);
  for (std::size_t i = 0; i < count; ++i) check::non_negative("masses", masses.data()[i]);
  check::non_negative("constant", constant);
  check::non_negative("softening", softening);
  check::between("accuracy", accuracy, 0, 0.1);
  Out<double, 2> accelerations(count, 3);
  Out<double, 1> potentials(count), rates(count);
  if (count) {
    const GravityFunctions* quad_functions = gravity_in_quads();
    const GravityFunctions& gravity_functions =
        quad_functions ? *quad_functions : GravityKernels<Portable>::functions;
    Bodies bodies(points.data(), masses.data(), count, softening);
    bodies.acceleration = accelerations.get();
    bodies.potential = potentials.get();
    bodies.max_squared_frequency = rates.get();
    if (accuracy > 0)
      sum_by_tree(bodies, points.data(), masses.data(), constant, accuracy, gravity_functions);
    else
      sum_directly(bodies, points.data(), masses.data(), constant, gravity_functions);
  }
  return {std::move(accelerations), std::move(potentials), std::move(rates)};
}

}  // namespace animtool
