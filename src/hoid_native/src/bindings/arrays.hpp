// NumPy arrays as arguments and results. An argument of another dtype or shape than the kernel's
// raises a TypeError. One that is not contiguous is copied.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "common/image.hpp"

namespace nb = nanobind;

namespace hoid::bindings {

// Template arguments of nb::shape; the oldest nanobind, of Ubuntu 24.04, has unsigned ones.
#if NB_VERSION_MAJOR < 2
using Extent = std::size_t;
#else
using Extent = nb::ssize_t;
#endif

template <int... kShape>
using Shape = nb::shape<static_cast<Extent>(kShape)...>;

// An argument of exactly this dtype and shape (-1: any length). An array that is not contiguous is
// copied.
template <typename T, int... kShape>
struct Array
{
  using Imported = nb::ndarray<const T, Shape<kShape...>, nb::c_contig, nb::device::cpu>;

  Imported array;

  const T* data() const { return array.data(); }
  int size(int axis = 0) const { return static_cast<int>(array.shape(axis)); }
};

// An argument of any real dtype, converted to double.
template <int... kShape>
struct RealArray : Array<double, kShape...>
{
};

template <typename T>
using Vector = Array<T, -1>;

template <typename T>
using ImageArray = Array<T, -1, -1>;

using BoxArray = RealArray<-1, 4>;

template <typename T>
Image<T> view(const ImageArray<T>& array)
{
  return {array.data(), array.size(1), array.size(0)};
}

inline Boxes view(const BoxArray& array)
{
  return {array.data(), array.size()};
}

// Return an array to Python without a copy.
template <typename T, typename Element = T, std::size_t kDimensions>
nb::ndarray<nb::numpy, Element, nb::ndim<kDimensions>> give(
  std::vector<T>&& values, const std::array<std::size_t, kDimensions>& shape)
{
  static_assert(sizeof(T) == sizeof(Element));
  auto* kept = new std::vector<T>(std::move(values));
  const nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return {kept->data(), kDimensions, shape.data(), owner};
}

template <typename T>
nb::ndarray<nb::numpy, T, nb::ndim<1>> give(std::vector<T>&& values)
{
  const std::array<std::size_t, 1> shape{values.size()};
  return give<T>(std::move(values), shape);
}

// Make the named tuple of hoid_native.results that `Result` names.
template <typename Result, typename... Fields>
Result make(Fields&&... fields)
{
  static const nb::object type = nb::module_::import_("hoid_native.results").attr(Result::kName);
  return nb::steal<Result>(type(std::forward<Fields>(fields)...).release());
}

// Run a kernel without Python's global lock.
template <typename Kernel>
auto unlocked(Kernel kernel)
{
  const nb::gil_scoped_release release;
  return kernel();
}

}  // namespace hoid::bindings

// Declares a named tuple of hoid_native.results as a return type.
#define HOID_RESULT(Class)                                                              \
  struct Class : nb::object                                                             \
  {                                                                                     \
    using nb::object::object;                                                           \
    static constexpr const char* kName = #Class;                                        \
    static constexpr auto Name = nb::detail::const_name("hoid_native.results." #Class); \
  }

namespace nanobind::detail {

template <typename T, int... kShape>
struct type_caster<hoid::bindings::Array<T, kShape...>>
{
  using Argument = hoid::bindings::Array<T, kShape...>;
  using Strided = ndarray<const T, hoid::bindings::Shape<kShape...>, device::cpu>;

  NB_TYPE_CASTER(Argument, (make_caster<ndarray<const T, hoid::bindings::Shape<kShape...>>>::Name))

  bool from_python(handle source, auto flags, cleanup_list* cleanup) noexcept
  {
    constexpr auto kConvert = static_cast<decltype(flags)>(cast_flags::convert);
    make_caster<typename Argument::Imported> exact;
    if (!exact.from_python(source, flags & ~kConvert, cleanup)) {
      make_caster<Strided> strided;
      if (
        !strided.from_python(source, flags & ~kConvert, cleanup) ||
        !exact.from_python(source, flags | kConvert, cleanup)) {
        return false;
      }
    }
    value.array = std::move(exact.value);
    return true;
  }
};

template <int... kShape>
struct type_caster<hoid::bindings::RealArray<kShape...>>
{
  using Argument = hoid::bindings::RealArray<kShape...>;

  NB_TYPE_CASTER(Argument, const_name("numpy.typing.NDArray[typing.Any]"))

  bool from_python(handle source, auto flags, cleanup_list* cleanup) noexcept
  {
    make_caster<typename Argument::Imported> real;
    constexpr auto kConvert = static_cast<decltype(flags)>(cast_flags::convert);
    if (!real.from_python(source, flags | kConvert, cleanup)) {
      return false;
    }
    value.array = std::move(real.value);
    return true;
  }
};

}  // namespace nanobind::detail
