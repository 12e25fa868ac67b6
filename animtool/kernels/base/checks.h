// Checks of arguments, once at the boundary of each exported function. What fails one is a
// ValueError in Python that begins with the argument's name: "columns: 34 is not between 0
// and 2". Indices, offsets, counts and settings are always checked. Large arrays of float64
// are checked for NaN and infinity only where these would hang or index out of range; else
// they go through to the result.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <initializer_list>
#include <limits>
#include <stdexcept>
#include <string>
#include <type_traits>

namespace animtool::check {

// A dimension of any size.
constexpr std::size_t ANY = std::numeric_limits<std::size_t>::max();
// Rows of arrays that loops go through with int32, a row being at most 12 numbers.
constexpr std::size_t MOST_ROWS = std::numeric_limits<std::int32_t>::max() / 12;

[[noreturn]] inline void refuse(const char* name, const std::string& what) {
  throw std::invalid_argument(std::string(name) + ": " + what);
}

template <class T>
std::string text(T value) {
  if constexpr (std::is_floating_point_v<T>) {
    char digits[40];
    std::snprintf(digits, sizeof digits, "%.9g", static_cast<double>(value));
    return digits;
  } else {
    return std::to_string(value);
  }
}

// The shape, ANY for sizes that are free, and that numbers are where their type may be.
template <class Array>
void shape(const char* name, const Array& array, std::initializer_list<std::size_t> sizes) {
  bool fits = array.ndim() == sizes.size();
  std::size_t axis = 0;
  for (const std::size_t size : sizes) {
    fits = fits && (size == ANY || array.shape(axis) == size);
    ++axis;
  }
  if (!fits) {
    std::string found, asked;
    for (std::size_t i = 0; i < array.ndim(); ++i)
      found += (i ? ", " : "") + text(array.shape(i));
    for (const std::size_t size : sizes)
      asked += (asked.empty() ? "" : ", ") + (size == ANY ? "any" : text(size));
    refuse(name, "shape (" + found + ") is not (" + asked + ")");
  }
  using Number = std::remove_pointer_t<decltype(array.data())>;
  if (reinterpret_cast<std::uintptr_t>(array.data()) % alignof(Number))
    refuse(name, "the array is not aligned");
}

// A number or a count in a closed range; NaN is in none.
template <class T>
void between(const char* name, T value, std::type_identity_t<T> low,
             std::type_identity_t<T> high) {
  if (value >= low && value <= high) return;
  refuse(name, text(value) + " is not between " + text(low) + " and " + text(high));
}

inline void at_most(const char* name, std::size_t rows, std::size_t most) {
  if (rows > most) refuse(name, text(rows) + " rows are more than " + text(most));
}

// Points (N, 3) that loops go through; returns how many.
template <class Array>
std::size_t points(const char* name, const Array& array) {
  shape(name, array, {ANY, 3});
  at_most(name, array.shape(0), MOST_ROWS);
  return array.shape(0);
}

inline void finite(const char* name, double value) {
  if (!std::isfinite(value)) refuse(name, text(value) + " is not finite");
}

inline void positive(const char* name, double value) {
  if (!(std::isfinite(value) && value > 0))
    refuse(name, text(value) + " is not above 0 and finite");
}

inline void not_negative(const char* name, double value) {
  if (!(std::isfinite(value) && value >= 0))
    refuse(name, text(value) + " is not 0 or more and finite");
}

// How many of an array are not as they should be: counted without branches, in numbers of the
// same width, so that the processor looks at several at once.
template <class T, class Good>
bool all(const T* values, std::size_t begin, std::size_t end, Good good) {
  using Count = std::conditional_t<sizeof(T) == 4, std::uint32_t, std::uint64_t>;
  Count bad = 0;
  for (std::size_t i = begin; i < end; ++i) bad |= static_cast<Count>(!good(values + i));
  return !bad;
}

template <class T>
void finite(const char* name, const T* values, std::size_t count) {
  constexpr T most = std::numeric_limits<T>::max();
  if (all(values, 0, count, [](const T* at) { return std::fabs(*at) <= most; })) return;
  for (std::size_t i = 0; i < count; ++i)
    if (!std::isfinite(values[i]))
      refuse(name, text(values[i]) + " at index " + text(i) + " is not finite");
}

template <class Array>
void finite(const char* name, const Array& array) {
  finite(name, array.data(), array.size());
}

// Indices from `low` to before `end`.
template <class T>
void indices(const char* name, const T* values, std::size_t count, std::int64_t low,
             std::int64_t end) {
  constexpr std::int64_t most = std::numeric_limits<T>::max();
  const T least = static_cast<T>(low), last = static_cast<T>(end - 1 < most ? end - 1 : most);
  const auto good = [&](const T* at) { return (*at >= least) & (*at <= last); };
  if (all(values, 0, count, good)) return;
  for (std::size_t i = 0; i < count; ++i) {
    if (good(values + i)) continue;
    if (end <= low) refuse(name, text(values[i]) + " where nothing can be named");
    refuse(name, text(values[i]) + " is not between " + text(low) + " and " + text(end - 1));
  }
}

template <class Array>
void indices(const char* name, const Array& array, std::int64_t low, std::int64_t end) {
  indices(name, array.data(), array.size(), low, end);
}

// Each number at least as large as the one before it; NaN is not.
template <class T>
void ascending(const char* name, const T* values, std::size_t count) {
  if (!count) return;
  const auto good = [](const T* at) { return at[0] >= at[-1]; };
  if (values[0] == values[0] && all(values, 1, count, good)) return;
  for (std::size_t i = 0; i < count; ++i)
    if (!(i ? good(values + i) : values[0] == values[0]))
      refuse(name, "it does not ascend at index " + text(i));
}

// Where the rows of a ragged array begin: from 0 to its length. Rows may be empty.
template <class Array>
void starts(const char* name, const Array& first, std::size_t length) {
  const auto* at = first.data();
  const std::size_t rows = first.size();
  if (!rows || at[0] != 0 || at[rows - 1] != static_cast<std::int64_t>(length))
    refuse(name, "it does not go from 0 to " + text(length));
  ascending(name, at, rows);
}

}  // namespace animtool::check
