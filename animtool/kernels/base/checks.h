// Checks of arguments, once at the boundary of each exported function. What fails one is a
// ValueError in Python that begins with the argument's name: "columns: 34 is not between 0
// and 2". Indices, offsets, counts and settings are always checked. Large arrays of float64
// are checked for NaN and infinity only where these would hang or index out of range; else
// they go through to the result.
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
// Rows of arrays that loops go through with int32, a row being at most 12 numbers.
constexpr std::size_t MOST_ROWS = std::numeric_limits<std::int32_t>::max() / 12;

[[noreturn]] void refuse(const char* name, const std::string& what);

// Each type of number is one of three as text.
template <class T>
using Shown = std::conditional_t<
    std::is_floating_point_v<T>, double,
    std::conditional_t<std::is_signed_v<T>, std::int64_t, std::uint64_t>>;

std::string shown(double value);
std::string shown(std::int64_t value);
std::string shown(std::uint64_t value);

template <class T>
std::string text(T value) {
  return shown(static_cast<Shown<T>>(value));
}

// The shape, ANY for sizes that are free, and that numbers are where their type may be.
void shape(const char* name, const std::size_t* actual, std::size_t axes, const void* data,
           std::size_t alignment, std::initializer_list<std::size_t> sizes);

template <class Array>
void shape(const char* name, const Array& array, std::initializer_list<std::size_t> sizes) {
  shape(name, array.lengths(), array.ndim(), array.data(), alignof(decltype(*array.data())),
        sizes);
}

template <class T>
[[noreturn]] void refuse_range(const char* name, T value, T low, T high);

// A number or a count in a closed range; NaN is in none.
template <class T>
void between(const char* name, T value, std::type_identity_t<T> low,
             std::type_identity_t<T> high) {
  if (value >= low && value <= high) return;
  refuse_range<Shown<T>>(name, value, low, high);
}

void at_most(const char* name, std::size_t rows, std::size_t most);

// Points (N, 3) that loops go through; returns how many.
template <class Array>
std::size_t points(const char* name, const Array& array) {
  shape(name, array, {ANY, 3});
  at_most(name, array.shape(0), MOST_ROWS);
  return array.shape(0);
}

void finite(const char* name, double value);
void positive(const char* name, double value);
void not_negative(const char* name, double value);

// Of float and double.
template <class T>
void finite(const char* name, const T* values, std::size_t count);

template <class Array>
void finite(const char* name, const Array& array) {
  finite(name, array.data(), array.size());
}

// A shape, and no number that is not finite.
template <class Array>
void numbers(const char* name, const Array& array, std::initializer_list<std::size_t> sizes) {
  shape(name, array, sizes);
  finite(name, array);
}

// Indices from `low` to before `end`, of int32, int64 and uint8.
template <class T>
void indices(const char* name, const T* values, std::size_t count, std::int64_t low,
             std::int64_t end);

template <class Array>
void indices(const char* name, const Array& array, std::int64_t low, std::int64_t end) {
  indices(name, array.data(), array.size(), low, end);
}

// Each number at least as large as the one before it; NaN is not.
template <class T>
void ascending(const char* name, const T* values, std::size_t count);

// Where the rows of a ragged array begin: from 0 to its length. Rows may be empty.
template <class T>
void starts(const char* name, const T* first, std::size_t rows, std::size_t length);

template <class Array>
void starts(const char* name, const Array& first, std::size_t length) {
  starts(name, first.data(), first.size(), length);
}

}  // namespace animtool::check
