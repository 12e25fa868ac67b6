// Checks of arguments, done once in each exported function. A failed check raises a ValueError
// in Python that begins with the argument's name: "columns: 34 is not between 0 and 2".
// Indices, offsets, counts and settings are always checked. Large arrays of float64 are checked
// for NaN and infinity only if these would cause an endless loop or an index out of range;
// otherwise they propagate to the result.
#pragma once

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <string>
#include <type_traits>

namespace animtool::check {

// A dimension of any size.
constexpr std::size_t ANY = std::numeric_limits<std::size_t>::max();
// Largest number of rows of arrays that are indexed with int32; a row has at most 12 numbers.
constexpr std::size_t MAX_ROWS = std::numeric_limits<std::int32_t>::max() / 12;

// Raises a ValueError in Python: the argument's name, and what is wrong with it.
[[noreturn]] void refuse(const char* name, const std::string& message);

// The type that a number is converted to for messages: one of these three.
template <class T>
using Printable =
    std::conditional_t<std::is_floating_point_v<T>, double,
                       std::conditional_t<std::is_signed_v<T>, std::int64_t, std::uint64_t>>;

std::string number_text(double value);
std::string number_text(std::int64_t value);
std::string number_text(std::uint64_t value);

// Returns a number as text for messages.
template <class T>
std::string text(T value) {
  return number_text(static_cast<Printable<T>>(value));
}

// Checks the shape (ANY matches every size), and that the data is aligned.
void shape(const char* name, const std::size_t* actual_sizes, std::size_t axes, const void* data,
           std::size_t alignment, std::initializer_list<std::size_t> sizes);

template <class Array>
void shape(const char* name, const Array& array, std::initializer_list<std::size_t> sizes) {
  shape(name, array.lengths(), array.ndim(), array.data(), alignof(decltype(*array.data())), sizes);
}

template <class T>
[[noreturn]] void refuse_range(const char* name, T value, T low, T high);

// Checks that a number or a count is in a closed range; NaN is outside of any range.
template <class T>
void between(const char* name, T value, std::type_identity_t<T> low, std::type_identity_t<T> high) {
  if (value >= low && value <= high) return;
  refuse_range<Printable<T>>(name, value, low, high);
}

// Checks the number of rows of an array.
void at_most(const char* name, std::size_t rows, std::size_t max_rows);

// Checks the shape of points (N, 3); returns N.
template <class Array>
std::size_t points(const char* name, const Array& array) {
  shape(name, array, {ANY, 3});
  at_most(name, array.shape(0), MAX_ROWS);
  return array.shape(0);
}

// Checks a single number.
void finite(const char* name, double value);
void positive(const char* name, double value);
void non_negative(const char* name, double value);

// Checks that all numbers are finite; for float and double.
template <class T>
void finite(const char* name, const T* values, std::size_t count);

template <class Array>
void finite(const char* name, const Array& array) {
  finite(name, array.data(), array.size());
}

// Checks a shape, and that all numbers are finite.
template <class Array>
void numbers(const char* name, const Array& array, std::initializer_list<std::size_t> sizes) {
  shape(name, array, sizes);
  finite(name, array);
}

// Checks that indices are in [low, end), for int32, int64 and uint8.
template <class T>
void indices(const char* name, const T* values, std::size_t count, std::int64_t low,
             std::int64_t end);

template <class Array>
void indices(const char* name, const Array& array, std::int64_t low, std::int64_t end) {
  indices(name, array.data(), array.size(), low, end);
}

// Checks that numbers do not decrease; NaN fails.
template <class T>
void ascending(const char* name, const T* values, std::size_t count);

// Checks the row starts of a ragged array: ascending from 0 to its length. Rows may be empty.
template <class T>
void starts(const char* name, const T* first, std::size_t rows, std::size_t length);

template <class Array>
void starts(const char* name, const Array& first, std::size_t length) {
  starts(name, first.data(), first.size(), length);
}

}  // namespace animtool::check
