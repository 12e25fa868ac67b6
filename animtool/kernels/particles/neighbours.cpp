// Points sorted by the cells of a grid.
#include "particles/neighbours.h"

#include <limits>

namespace animtool {

namespace {

bool finite(const double* point) {
  return std::isfinite(point[0]) && std::isfinite(point[1]) && std::isfinite(point[2]);
}

std::int32_t* neighbours_one_by_one(const GridPoints& points, const GridRun* run,
                                    const GridRun* last, const double* at, std::int32_t* next) {
  // Each is written, and kept if near: a branch would be unpredictable.
  for (; run < last; ++run)
    for (std::size_t i = run->begin; i < run->end; ++i) {
      const double x = points.x[i] - at[0], y = points.y[i] - at[1], z = points.z[i] - at[2];
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
  std::vector<double> moved;  // positions wrapped into the periods, if different from `points`
  const bool open = !(period_[0] > 0 || period_[1] > 0 || period_[2] > 0);
  index_.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t which = subset ? static_cast<std::size_t>(subset[i]) : i;
    if (!finite(points + 3 * which)) continue;
    index_.push_back(static_cast<std::int32_t>(which));
  }
  if (!open) moved = images(points);
  const std::size_t total = index_.size();
  const auto at = [&](std::size_t i) {
    return open ? points + 3 * static_cast<std::size_t>(index_[i]) : &moved[3 * i];
  };
  double high[3] = {0, 0, 0};
  for (std::size_t i = 0; i < total; ++i)
    for (std::size_t k = 0; k < 3; ++k) {
      origin_[k] = i ? std::min(origin_[k], at(i)[k]) : at(i)[k];
      high[k] = i ? std::max(high[k], at(i)[k]) : at(i)[k];
    }
  for (std::size_t k = 0; k < 3; ++k) {
    // Halved, as the full extent may overflow.
    const double half = high[k] / 2 - origin_[k] / 2;
    inverse_cell_[k] = 1 / (SLACK * std::max(radius_, 2 * (half / MAX_CELLS)));
    last_cell_[k] = std::min(std::floor((high[k] - origin_[k]) * inverse_cell_[k]), MAX_CELLS);
  }
  row_ = static_cast<std::uint64_t>(last_cell_[0] + 1 + 2 * PAD);
  layer_ = row_ * static_cast<std::uint64_t>(last_cell_[1] + 1 + 2 * PAD);
  SortedKeys sorted(total);
  for (std::size_t i = 0; i < total; ++i) {
    sorted.keys[i] = key(at(i));
    sorted.indices[i] = static_cast<std::int32_t>(i);
  }
  sort_keys(sorted, total);
  cells_ = cells_of(sorted.keys.get(), total);
  sorted.keys.reset();
  const std::size_t stride = total + GRID_PADDING;
  grid_points_ = block<double>(3 * stride);
  for (std::size_t i = 0; i < total; ++i) {
    const double* from = at(static_cast<std::size_t>(sorted.indices[i]));
    for (std::size_t k = 0; k < 3; ++k) grid_points_[k * stride + i] = from[k];
  }
  double* grid_points = grid_points_.get();
  sorted_points_ = {grid_points, grid_points + stride, grid_points + 2 * stride, radius_ * radius_};
  for (std::size_t k = 0; k < 3; ++k)
    std::fill_n(grid_points + k * stride + total, GRID_PADDING, 0.0);
  std::vector<std::int32_t> index(total);
  for (std::size_t i = 0; i < total; ++i)
    index[i] = index_[static_cast<std::size_t>(sorted.indices[i])];
  index_ = std::move(index);
}

// Wraps points into the periods; points near an end are repeated beyond the other, axis by axis,
// with an index for each image.
std::vector<double> Neighbours::images(const double* points) {
  std::vector<double> positions(3 * index_.size());
  for (std::size_t i = 0; i < index_.size(); ++i)
    wrapped(points + 3 * static_cast<std::size_t>(index_[i]), &positions[3 * i]);
  for (std::size_t k = 0; k < 3; ++k) {
    if (!(period_[k] > 0)) continue;
    for (std::size_t i = 0, count = index_.size(); i < count; ++i)
      for (const double side : {1.0, -1.0}) {
        const double from = positions[3 * i + k] - low_[k];
        if ((side > 0 ? from : period_[k] - from) > radius_) continue;
        double image[3];
        std::copy_n(&positions[3 * i], 3, image);
        image[k] += side * period_[k];
        positions.insert(positions.end(), image, image + 3);
        index_.push_back(index_[i]);
      }
  }
  return positions;
}

void Neighbours::wrapped(const double* point, double* out) const {
  for (std::size_t k = 0; k < 3; ++k) {
    out[k] = point[k];
    if (period_[k] > 0) out[k] -= period_[k] * std::floor((point[k] - low_[k]) / period_[k]);
  }
}

bool Neighbours::inside(const double* point) const {
  for (std::size_t k = 0; k < 3; ++k) {
    const double cell = (point[k] - origin_[k]) * inverse_cell_[k];
    if (!(cell >= -1 && cell < last_cell_[k] + 2)) return false;
  }
  return true;
}

std::uint64_t Neighbours::key(const double* point) const {
  std::uint64_t cells[3];
  for (std::size_t k = 0; k < 3; ++k) {
    const double cell = (point[k] - origin_[k]) * inverse_cell_[k] + PAD;
    cells[k] = static_cast<std::uint64_t>(std::min(cell, last_cell_[k] + 1 + PAD));
  }
  return cells[0] + row_ * cells[1] + layer_ * cells[2];
}

SortedKeys Neighbours::query_keys(const double* points, const std::int32_t* subset,
                                  std::size_t count) const {
  SortedKeys sorted(count);
  if (index_.empty()) return sorted;
  for (std::size_t i = 0; i < count; ++i) {
    double at[3];
    wrapped(points + 3 * (subset ? static_cast<std::size_t>(subset[i]) : i), at);
    if (!inside(at)) continue;
    sorted.keys[sorted.count] = key(at);
    sorted.indices[sorted.count++] = static_cast<std::int32_t>(i);
  }
  sort_keys(sorted, sorted.count);
  return sorted;
}

std::vector<Neighbours::Cell> Neighbours::cells_of(const std::uint64_t* keys, std::size_t count) {
  std::size_t distinct = 1;
  for (std::size_t i = 0; i < count; ++i) distinct += !i || keys[i] != keys[i - 1];
  std::vector<Cell> cells;
  cells.reserve(distinct);
  for (std::size_t i = 0; i < count; ++i)
    if (cells.empty() || keys[i] != cells.back().key) cells.push_back({keys[i], i});
  // No cell key is as large.
  cells.push_back({std::numeric_limits<std::uint64_t>::max(), count});
  return cells;
}

}  // namespace animtool
