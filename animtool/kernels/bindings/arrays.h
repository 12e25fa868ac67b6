// Conversion of kernel arguments and results: numpy arrays and bytes.
#pragma once

#include <cstring>

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "base/arrays.h"

namespace animtool {

namespace nb = nanobind;
using namespace nanobind::literals;

// Kernels run without the interpreter lock.
using WithoutLock = nb::call_guard<nb::gil_scoped_release>;

// A keyword argument that is stored in a member of the argument struct of a kernel.
template <class Struct, class Member>
struct Field {
  const char* name;
  Member Struct::* member;

  nb::arg arg() const { return nb::arg(name); }
};

// Binds a kernel whose arguments are stored in a struct.
template <class Result, class Struct, class... Members>
void define(nb::module_& m, const char* name, Result (*kernel)(const Struct&), const char* doc,
            Field<Struct, Members>... fields) {
  const auto call_kernel = [=](Members... members) {
    Struct arguments{};
    ((arguments.*fields.member = members), ...);
    return kernel(arguments);
  };
  m.def(name, call_kernel, WithoutLock(), fields.arg()..., doc);
}
// Binds the constructor of a class whose arguments are stored in a struct.
template <class Class, class Struct, class... Members>
void define_class(nb::class_<Class>& bound, Field<Struct, Members>... fields) {
  const auto construct = [=](Class* memory, Members... members) {
    Struct arguments{};
    ((arguments.*fields.member = members), ...);
    new (memory) Class(arguments);
  };
  bound.def("__init__", construct, fields.arg()...);
}

}  // namespace animtool

namespace nanobind::detail {

// Whether a buffer contains numbers of type T, by the format letters of Python's `struct`.
template <typename T>
bool has_format(const Py_buffer& buffer) {
  if (buffer.itemsize != sizeof(T) || !buffer.format || buffer.format[1]) return false;
  const char* letters = std::is_same_v<T, bool>       ? "?"
                        : std::is_floating_point_v<T> ? "fd"
                        : std::is_signed_v<T>         ? "bhilq"
                                                      : "BHILQ";
  return std::strchr(letters, buffer.format[0]);
}

// Arrays that match are read through their buffers, which is the fastest way. Other arguments are
// converted. Both stay alive until the call returns, like the arguments.
template <typename T, std::size_t N>
struct type_caster<animtool::View<T, N>> {
  using Array = ndarray<T, ndim<N>, c_contig, device::cpu>;
  using Caster = make_caster<Array>;
  using View = animtool::View<T, N>;
  NB_TYPE_CASTER(View, Caster::Name)

  type_caster() = default;
  type_caster(const type_caster&) = delete;
  type_caster(type_caster&&) = delete;
  ~type_caster() {
    if (buffer_.obj) PyBuffer_Release(&buffer_);
  }

  bool from_python(handle source, std::uint32_t flags, cleanup_list* cleanup) noexcept {
    std::array<std::size_t, N> shape{};
    constexpr int requirements =
        PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (std::is_const_v<T> ? 0 : PyBUF_WRITABLE);
    if (!PyObject_GetBuffer(source.ptr(), &buffer_, requirements)) {
      if (buffer_.ndim == N && has_format<std::remove_const_t<T>>(buffer_)) {
        for (std::size_t axis = 0; axis < N; ++axis)
          shape[axis] = static_cast<std::size_t>(buffer_.shape[axis]);
        value = View(static_cast<T*>(buffer_.buf), shape);
        return true;
      }
    } else {
      PyErr_Clear();
    }
    if (!caster_.from_python(source, flags, cleanup)) return false;
    const Array& array = caster_.value;
    for (std::size_t axis = 0; axis < N; ++axis) shape[axis] = array.shape(axis);
    value = View(array.data(), shape);
    return true;
  }

 private:
  Py_buffer buffer_{};
  Caster caster_;
};

template <typename T, std::size_t N>
struct type_caster<animtool::Out<T, N>> {
  using Array = ndarray<numpy, T, ndim<N>, c_contig>;
  using Value = animtool::Out<T, N>;
  static constexpr auto Name = make_caster<Array>::Name;

  static handle from_cpp(Value&& out, rv_policy policy, cleanup_list* cleanup) noexcept {
    T* data = out.release();
    capsule owner(data, [](void* memory) noexcept { animtool::FreeDeleter()(memory); });
    return make_caster<Array>::from_cpp(Array(data, N, out.shape().data(), owner), policy, cleanup);
  }
};

template <>
struct type_caster<animtool::Text> {
  NB_TYPE_CASTER(animtool::Text, const_name("bytes"))

  bool from_python(handle source, std::uint32_t, cleanup_list*) noexcept {
    if (!isinstance<bytes>(source)) return false;
    const auto text = borrow<bytes>(source);
    value.bytes = {text.c_str(), text.size()};
    return true;
  }
};

template <>
struct type_caster<animtool::Bytes> {
  using Value = animtool::Bytes;
  static constexpr auto Name = const_name("bytes");

  static handle from_cpp(const Value& bound, rv_policy, cleanup_list*) noexcept {
    return bytes(bound.bytes.data(), bound.bytes.size()).release();
  }
};

}  // namespace nanobind::detail
