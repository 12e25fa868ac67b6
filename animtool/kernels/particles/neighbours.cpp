// Sorts points by the cells of a grid.
#include "particles/neighbours.h"

#include <limits>

namespace animtool {

namespace {

bool is_finite(const double* point) {
  return std::isfinite(point[0]) && std::isfinite(point[1]) && std::isfinite(point[2]);
}

std::int32_t* neighbours_one_by_one(const GridPoints& points, const GridRun* run,
                                    const GridRun* last, const double* point, std::int32_t* next) {
  // Every point is written, and the end advances only if it is near. A branch here would be
  // unpredictable.
  for (; run < last; ++run)
    for (std::size_t i = run->begin; i < run->end; ++i) {
      const double x = points.x[i] - point[0], y = points.y[i] - point[1],
                   z = points.z[i] - point[2];
      *next = static_cast<std::int32_t>(i);
      next += x * x + y * y + z * z <= points.squared_radius;
    }
  return next;
}

}  // namespace

Neighbours::Neighbours(const double* points, const std::int32_t* subset, std::size_t count,
                       double radius, const double* low, const double* period)
    : radius_(radius), find_neighbours_(neighbours_in_quads()) {
  if (!find_neighbours_) find_neighbours_ = neighbours_one_by_one;
  std::copy_n(low, 3, low_);
  std::copy_n(period, 3, period_);
  std::vector<double>
      wrapped_points;  // positions wrapped into the periods, used if an axis is periodic
  const bool has_no_period = !(period_[0] > 0 || period_[1] > 0 || period_[2] > 0);
  point_indices_.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t point_index = subset ? static_cast<std::size_t>(subset[i]) : i;
    if (!is_finite(points + 3 * point_index)) continue;
    point_indices_.push_back(static_cast<std::int32_t>(point_index));
  }
  if (!has_no_period) wrapped_points = add_images(points);
  const std::size_t grid_count = point_indices_.size();
  const auto position = [&](std::size_t i) {
    return has_no_period ? points + 3 * static_cast<std::size_t>(point_indices_[i])
                         : &wrapped_points[3 * i];
  };
  double high[3] = {0, 0, 0};
  for (std::size_t i = 0; i < grid_count; ++i)
    for (std::size_t k = 0; k < 3; ++k) {
      origin_[k] = i ? std::min(origin_[k], position(i)[k]) : position(i)[k];
      high[k] = i ? std::max(high[k], position(i)[k]) : position(i)[k];
    }
  for (std::size_t k = 0; k < 3; ++k) {
    // The extent is halved because the full extent may overflow.
    const double half_extent = high[k] / 2 - origin_[k] / 2;
    inverse_cell_[k] =
        1 / (CELL_WIDTH_FACTOR * std::max(radius_, 2 * (half_extent / MAX_CELLS_PER_AXIS)));
    max_cell_index_[k] =
        std::min(std::floor((high[k] - origin_[k]) * inverse_cell_[k]), MAX_CELLS_PER_AXIS);
  }
  row_stride_ = static_cast<std::uint64_t>(max_cell_index_[0] + 1 + 2 * MARGIN_CELLS);
  layer_stride_ =
      row_stride_ * static_cast<std::uint64_t>(max_cell_index_[1] + 1 + 2 * MARGIN_CELLS);
  SortedKeys sorted(grid_count);
  for (std::size_t i = 0; i < grid_count; ++i) {
    sorted.keys[i] = find_key(position(i));
    sorted.indices[i] = static_cast<std::int32_t>(i);
  }
  sort_keys(sorted, grid_count);
  cells_ = find_cells(sorted.keys.get(), grid_count);
  sorted.keys.reset();
  const std::size_t stride = grid_count + GRID_PADDING;
  grid_points_ = block<double>(3 * stride);
  for (std::size_t i = 0; i < grid_count; ++i) {
    const double* point = position(static_cast<std::size_t>(sorted.indices[i]));
    for (std::size_t k = 0; k < 3; ++k) grid_points_[k * stride + i] = point[k];
  }
  double* grid_points = grid_points_.get();
  sorted_points_ = {grid_points, grid_points + stride, grid_points + 2 * stride, radius_ * radius_};
  for (std::size_t k = 0; k < 3; ++k)
    std::fill_n(grid_points + k * stride + grid_count, GRID_PADDING, 0.0);
  std::vector<std::int32_t> sorted_index(grid_count);
  for (std::size_t i = 0; i < grid_count; ++i)
    sorted_index[i] = point_indices_[static_cast<std::size_t>(sorted.indices[i])];
  point_indices_ = std::move(sorted_index);
}

// Wraps points into the periods. Points near an end of a period are repeated beyond the other end,
// axis by axis, and each image has an index.
std::vector<double> Neighbours::add_images(const double* points) {
  std::vector<double> positions(3 * point_indices_.size());
  for (std::size_t i = 0; i < point_indices_.size(); ++i)
    wrap_into_period(points + 3 * static_cast<std::size_t>(point_indices_[i]), &positions[3 * i]);
  for (std::size_t k = 0; k < 3; ++k) {
    if (!(period_[k] > 0)) continue;
    for (std::size_t i = 0, count = point_indices_.size(); i < count; ++i)
      for (const double side : {1.0, -1.0}) {
        const double distance_from_low = positions[3 * i + k] - low_[k];
        if ((side > 0 ? distance_from_low : period_[k] - distance_from_low) > radius_) continue;
        double image[3];
        std::copy_n(&positions[3 * i], 3, image);
        image[k] += side * period_[k];
        positions.insert(positions.end(), image, image + 3);
        point_indices_.push_back(point_indices_[i]);
      }
  }
  return positions;
}

void Neighbours::wrap_into_period(const double* point, double* out) const {
  for (std::size_t k = 0; k < 3; ++k) {
    out[k] = point[k];
    if (period_[k] > 0) out[k] -= period_[k] * std::floor((point[k] - low_[k]) / period_[k]);
  }
}

bool Neighbours::is_near_grid(const double* point) const {
  for (std::size_t k = 0; k < 3; ++k) {
    const double cell = (point[k] - origin_[k]) * inverse_cell_[k];
    if (!(cell >= -1 && cell < max_cell_index_[k] + 2)) return false;
  }
  return true;
}

std::uint64_t Neighbours::find_key(const double* point) const {
  std::uint64_t cells[3];
  for (std::size_t k = 0; k < 3; ++k) {
    const double cell = (point[k] - origin_[k]) * inverse_cell_[k] + MARGIN_CELLS;
    cells[k] = static_cast<std::uint64_t>(std::min(cell, max_cell_index_[k] + 1 + MARGIN_CELLS));
  }
  return cells[0] + row_stride_ * cells[1] + layer_stride_ * cells[2];
}

SortedKeys Neighbours::query_keys(const double* points, const std::int32_t* subset,
                                  std::size_t count) const {
  SortedKeys sorted(count);
  if (point_indices_.empty()) return sorted;
  for (std::size_t i = 0; i < count; ++i) {
    double position[3];
    wrap_into_period(points + 3 * (subset ? static_cast<std::size_t>(subset[i]) : i), position);
    if (!is_near_grid(position)) continue;
    sorted.keys[sorted.count] = find_key(position);
    sorted.indices[sorted.count++] = static_cast<std::int32_t>(i);
  }
  sort_keys(sorted, sorted.count);
  return sorted;
}

std::vector<Neighbours::Cell> Neighbours::find_cells(const std::uint64_t* keys, std::size_t count) {
  std::size_t distinct_count = 1;
  for (std::size_t i = 0; i < count; ++i) distinct_count += !i || keys[i] != keys[i - 1];
  std::vector<Cell> cells;
  cells.reserve(distinct_count);
  for (std::size_t i = 0; i < count; ++i)
    if (cells.empty() || keys[i] != cells.back().key) cells.push_back({keys[i], i});
  // A sentinel: no cell key is as large.
  cells.push_back({std::numeric_limits<std::uint64_t>::max(), count});
  return cells;
}

}  // namespace animtool
