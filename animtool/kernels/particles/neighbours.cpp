// Points sorted by the cells of a grid.
#include "particles/neighbours.h"

#include <limits>

namespace animtool {

namespace {

bool finite(const double* point) {
  return std::isfinite(point[0]) && std::isfinite(point[1]) && std::isfinite(point[2]);
}

std::int32_t* near_one(const NearPlaces& places, const NearRun* run, const NearRun* last,
                       const double* at, std::int32_t* next) {
  // Each is written, and kept if near: a branch would be unpredictable.
  for (; run < last; ++run)
    for (std::size_t i = run->begin; i < run->end; ++i) {
      const double x = places.x[i] - at[0], y = places.y[i] - at[1], z = places.z[i] - at[2];
      *next = static_cast<std::int32_t>(i);
      next += x * x + y * y + z * z <= places.most;
    }
  return next;
}

}  // namespace

Neighbours::Neighbours(const double* points, const std::int32_t* chosen, std::size_t count,
                       double radius, const double* low, const double* period)
    : radius_(radius), near_(near_in_quads()) {
  if (!near_) near_ = near_one;
  std::copy_n(low, 3, low_);
  std::copy_n(period, 3, period_);
  std::vector<double> moved;  // positions wrapped into the periods, if different from `points`
  const bool open = !(period_[0] > 0 || period_[1] > 0 || period_[2] > 0);
  index_.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t which = chosen ? static_cast<std::size_t>(chosen[i]) : i;
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
      first_[k] = i ? std::min(first_[k], at(i)[k]) : at(i)[k];
      high[k] = i ? std::max(high[k], at(i)[k]) : at(i)[k];
    }
  for (std::size_t k = 0; k < 3; ++k) {
    // Halved, as the full extent may overflow.
    const double half = high[k] / 2 - first_[k] / 2;
    over_[k] = 1 / (SLACK * std::max(radius_, 2 * (half / MOST_CELLS)));
    last_[k] = std::min(std::floor((high[k] - first_[k]) * over_[k]), MOST_CELLS);
  }
  row_ = static_cast<std::uint64_t>(last_[0] + 1 + 2 * PAD);
  layer_ = row_ * static_cast<std::uint64_t>(last_[1] + 1 + 2 * PAD);
  SortedKeys sorted(total);
  for (std::size_t i = 0; i < total; ++i) {
    sorted.keys[i] = key(at(i));
    sorted.places[i] = static_cast<std::int32_t>(i);
  }
  sort_keys(sorted, total);
  cells_ = cells_of(sorted.keys.get(), total);
  sorted.keys.reset();
  const std::size_t stride = total + NEAR_SPARE;
  places_ = block<double>(3 * stride);
  for (std::size_t i = 0; i < total; ++i) {
    const double* from = at(static_cast<std::size_t>(sorted.places[i]));
    for (std::size_t k = 0; k < 3; ++k) places_[k * stride + i] = from[k];
  }
  double* places = places_.get();
  near_places_ = {places, places + stride, places + 2 * stride, radius_ * radius_};
  for (std::size_t k = 0; k < 3; ++k) std::fill_n(places + k * stride + total, NEAR_SPARE, 0.0);
  std::vector<std::int32_t> index(total);
  for (std::size_t i = 0; i < total; ++i)
    index[i] = index_[static_cast<std::size_t>(sorted.places[i])];
  index_ = std::move(index);
}

// Wraps points into the periods; points near an end are repeated beyond the other, axis by axis,
// with an index for each image.
std::vector<double> Neighbours::images(const double* points) {
  std::vector<double> places(3 * index_.size());
  for (std::size_t i = 0; i < index_.size(); ++i)
    wrapped(points + 3 * static_cast<std::size_t>(index_[i]), &places[3 * i]);
  for (std::size_t k = 0; k < 3; ++k) {
    if (!(period_[k] > 0)) continue;
    for (std::size_t i = 0, own = index_.size(); i < own; ++i)
      for (const double way : {1.0, -1.0}) {
        const double from = places[3 * i + k] - low_[k];
        if ((way > 0 ? from : period_[k] - from) > radius_) continue;
        double image[3];
        std::copy_n(&places[3 * i], 3, image);
        image[k] += way * period_[k];
        places.insert(places.end(), image, image + 3);
        index_.push_back(index_[i]);
      }
  }
  return places;
}

void Neighbours::wrapped(const double* point, double* out) const {
  for (std::size_t k = 0; k < 3; ++k) {
    out[k] = point[k];
    if (period_[k] > 0) out[k] -= period_[k] * std::floor((point[k] - low_[k]) / period_[k]);
  }
}

bool Neighbours::inside(const double* point) const {
  for (std::size_t k = 0; k < 3; ++k) {
    const double cell = (point[k] - first_[k]) * over_[k];
    if (!(cell >= -1 && cell < last_[k] + 2)) return false;
  }
  return true;
}

std::uint64_t Neighbours::key(const double* point) const {
  std::uint64_t cells[3];
  for (std::size_t k = 0; k < 3; ++k) {
    const double cell = (point[k] - first_[k]) * over_[k] + PAD;
    cells[k] = static_cast<std::uint64_t>(std::min(cell, last_[k] + 1 + PAD));
  }
  return cells[0] + row_ * cells[1] + layer_ * cells[2];
}

SortedKeys Neighbours::seekers(const double* points, const std::int32_t* chosen,
                                       std::size_t count) const {
  SortedKeys sorted(count);
  if (index_.empty()) return sorted;
  for (std::size_t i = 0; i < count; ++i) {
    double at[3];
    wrapped(points + 3 * (chosen ? static_cast<std::size_t>(chosen[i]) : i), at);
    if (!inside(at)) continue;
    sorted.keys[sorted.count] = key(at);
    sorted.places[sorted.count++] = static_cast<std::int32_t>(i);
  }
  sort_keys(sorted, sorted.count);
  return sorted;
}

std::vector<Neighbours::Cell> Neighbours::cells_of(const std::uint64_t* keys,
                                                   std::size_t count) {
  std::size_t different = 1;
  for (std::size_t i = 0; i < count; ++i) different += !i || keys[i] != keys[i - 1];
  std::vector<Cell> cells;
  cells.reserve(different);
  for (std::size_t i = 0; i < count; ++i)
    if (cells.empty() || keys[i] != cells.back().key) cells.push_back({keys[i], i});
  // No cell key is as large.
  cells.push_back({std::numeric_limits<std::uint64_t>::max(), count});
  return cells;
}

}  // namespace animtool
