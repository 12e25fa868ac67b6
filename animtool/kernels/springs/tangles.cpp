// Untangling of self-intersecting surfaces.
#include "springs/tangles.h"

#include <algorithm>
#include <cmath>

#include "springs/grid.h"
#include "springs/separation.h"

namespace animtool {

using collide::load;
using collide::store;
using collide::Vec;

double pierces_at(const shapes::Segment& edge, const shapes::Triangle& t) {
  const Vec normal = cross(t.b - t.a, t.c - t.a);
  const double first = dot(edge.a - t.a, normal), last = dot(edge.b - t.a, normal);
  if (!(first * last < 0)) return -1;
  const double fraction = first / (first - last);
  const Vec at = edge.at(fraction);
  const auto left = [&](Vec from, Vec to) { return dot(cross(to - from, at - from), normal) > 0; };
  return left(t.a, t.b) && left(t.b, t.c) && left(t.c, t.a) ? fraction : -1;
}

std::vector<Pierced> pierced_pairs(const std::vector<double>& x,
                                   const std::vector<std::int32_t>& ends,
                                   const std::vector<std::int32_t>& corners) {
  const std::size_t edges = ends.size() / 2;
  std::vector<Pierced> hit;
  std::vector<double> middles(ROW * edges);
  double longest = 0, lengths = 0;
  const auto segment = [&](std::size_t e) { return shapes::Segment(&ends[2 * e], x.data()); };
  for (std::size_t e = 0; e < edges; ++e) {
    store(segment(e).at(0.5), &middles[ROW * e]);
    const double entry = length(segment(e).shift());
    longest = std::max(longest, entry), lengths += entry;
  }
  if (!(lengths > 0)) return hit;
  PointGrid grid;
  grid.build(middles.data(), edges, lengths / static_cast<double>(edges));
  for (std::size_t t = 0; t < corners.size(); t += 3) {
    const shapes::Triangle triangle(&corners[t], x.data());
    double low[3], high[3];
    for (std::size_t k = 0; k < 3; ++k) {
      const auto at = [&](std::size_t i) {
        return x[ROW * static_cast<std::size_t>(corners[t + i]) + k];
      };
      low[k] = std::min({at(0), at(1), at(2)}) - longest / 2;
      high[k] = std::max({at(0), at(1), at(2)}) + longest / 2;
    }
    grid.visit(low, high, [&](std::int32_t e, const double*) {
      const std::int32_t* entry = &ends[2 * static_cast<std::size_t>(e)];
      for (std::size_t k = t; k < t + 3; ++k)
        if (corners[k] == entry[0] || corners[k] == entry[1]) return;
      if (pierces_at(segment(static_cast<std::size_t>(e)), triangle) >= 0)
        hit.push_back({e, static_cast<std::int32_t>(t / 3)});
    });
  }
  return hit;
}

Tangles::Tangles(const SpringLayers& layers, const std::vector<double>& inverse_masses)
    : layers_(layers),
      inverse_masses_(inverse_masses),
      adjacent_(layers.edges(), {-1, -1}),
      marked_(layers.particles(), 0) {
  for (std::size_t e = 0; e < layers.edges(); ++e)
    ends_.insert(ends_.end(), layers.ends(e), layers.ends(e) + 2);
  for (std::size_t t = 0; t < layers.triangles(); ++t)
    triangles_.insert(triangles_.end(), layers.corners(t), layers.corners(t) + 3);
  for (std::size_t t = 0; t < triangles_.size(); t += 3)
    for (std::size_t k = 0; k < 3; ++k) {
      const auto [i, j] = std::minmax(triangles_[t + k], triangles_[t + (k + 1) % 3]);
      // Edges are sorted by their ends.
      std::size_t low = 0, high = layers.edges();
      while (low < high) {
        const std::size_t middle = (low + high) / 2;
        if (std::pair(ends_[2 * middle], ends_[2 * middle + 1]) < std::pair(i, j))
          low = middle + 1;
        else
          high = middle;
      }
      auto& entry = adjacent_[low];
      entry[entry[0] < 0 ? 0 : 1] = triangles_[t + (k + 2) % 3];
    }
}

void Tangles::find(const std::vector<double>& x) {
  if (any()) std::fill(marked_.begin(), marked_.end(), 0);
  pairs_ = pierced_pairs(x, ends_, triangles_);
  for (const Pierced& one : pairs_) {
    const std::int32_t* ends = layers_.ends(static_cast<std::size_t>(one.edge));
    const std::int32_t* corners = layers_.corners(static_cast<std::size_t>(one.triangle));
    for (std::size_t k = 0; k < 2; ++k) marked_[static_cast<std::size_t>(ends[k])] = 1;
    for (std::size_t k = 0; k < 3; ++k) marked_[static_cast<std::size_t>(corners[k])] = 1;
  }
}

Vec Tangles::shorter(const Pierced& pair, const std::vector<double>& x) const {
  const auto e = static_cast<std::size_t>(pair.edge);
  const shapes::Segment edge(layers_.ends(e), x.data());
  const shapes::Triangle triangle(layers_.corners(static_cast<std::size_t>(pair.triangle)),
                                  x.data());
  const Vec normal = triangle.normal(), along = collide::direction(edge.shift(), Vec{});
  const double through = dot(along, normal);
  Vec sum;
  for (const std::int32_t third : adjacent_[e]) {
    if (third < 0) continue;
    const Vec off = shapes::row_of(x.data(), third) - edge.a;
    const Vec inward = off - along * dot(off, along);
    Vec line = collide::direction(cross(cross(along, inward), normal), Vec{});
    if (dot(line, inward) < 0) line = -line;
    // The piercing point slides along the edge, so that it stays in the plane of the triangle.
    sum = sum + line - normal * (dot(line, along) / through);
  }
  return collide::direction(sum, Vec{});
}

void Tangles::part(double shift, std::vector<double>& before, std::vector<double>& x) const {
  for (const Pierced& pair : pairs_) {
    const std::int32_t* ends = layers_.ends(static_cast<std::size_t>(pair.edge));
    const std::int32_t* corners = layers_.corners(static_cast<std::size_t>(pair.triangle));
    const shapes::Segment edge(ends, x.data());
    const shapes::Triangle triangle(corners, x.data());
    const double fraction = pierces_at(edge, triangle);
    if (fraction < 0) continue;
    const Vec out = shorter(pair, x);
    if (!(dot(out, out) > 0)) continue;
    const shapes::Nearest near = triangle.nearest(edge.at(fraction));
    const std::int32_t who[5] = {ends[0], ends[1], corners[0], corners[1], corners[2]};
    const double shares[5] = {1 - fraction, fraction, near.fraction[1], near.fraction[2],
                              near.fraction[3]};
    double full = 0, lightest = 0;
    for (std::size_t k = 0; k < 5; ++k) {
      const double inverse = inverse_masses_[static_cast<std::size_t>(who[k])];
      full += inverse * shares[k] * shares[k];
      lightest = std::max(lightest, inverse);
    }
    full = std::max(full, lightest / MAX_RATIO);
    if (!(full > 0)) continue;
    for (std::size_t k = 0; k < 5; ++k) {
      const auto n = static_cast<std::size_t>(who[k]);
      const Vec by = out * (shift * inverse_masses_[n] * shares[k] / full);
      store(load(&x[ROW * n]) + by, &x[ROW * n]);
      store(load(&before[ROW * n]) + by, &before[ROW * n]);
    }
  }
}

}  // namespace animtool
