/// The micromechanical contact: a felt of some thickness under an indenter.
///
/// The felt gives a pressure at a volume fraction, v = v_f0 / (1 - u / h) where its thickness h is
/// compressed by u (eq. 2.2); the pair of surfaces gives an area A(e) (thesis 4.1.5).
///   even:    F = A(e) P(e), the whole area compressed by e, as in the thesis;
///   columns: F = integral of P(e - g) dA(g) over 0 <= g <= e. The column under a gap g of the
///            indenter is compressed by e - g only; columns do not hold one another (Winkler).
/// A flat punch has one gap: there both are the same.
#pragma once

#include <memory>
#include <vector>

#include "feltmb/contact/area.hpp"
#include "feltmb/contact/envelope.hpp"
#include "feltmb/contact/path.hpp"
#include "feltmb/fiber/felt_material.hpp"

namespace feltmb {

/// Pressure [Pa] against engineering strain u / h [-]: a common table of all layers of one
/// material. Its end e_M is the strain at v_f_max. Loading is continued by the same equations to
/// half of the remaining volume fraction, v = (1 + v_f_max) / 2. It is made once per material.
/// Throws InvalidParameter.
std::shared_ptr<const Envelope> pressure_envelope(const FeltMaterial& material);

enum class LayerCompression { kEven, kColumns };

struct FeltLayer {
  /// Pressure [Pa] against engineering strain u / h [-]: pressure_envelope(material), or a measured
  /// loop through Envelope::from_table.
  std::shared_ptr<const Envelope> pressure;
  double thickness = 0.0;  ///< h without load [m], > 0
  ContactArea area;
  LayerCompression compression = LayerCompression::kEven;
};

/// Envelope of a contact through a felt layer, for the law with memory; made once a layer.
///
/// Even: F_L = A P_L, and unloading F_L rho(e / e_m) with the felt's rho. Columns: each column
/// remembers its own largest compression, e_m - g, and unloads along P_L rho(u / (e_m - g)):
///   F_L(e) = integral of P_L(e - g) dA(g),  F_U(e; e_m) likewise with P_L rho,
/// a table over e and e_m; the stick transition z is that of the contact. Throws InvalidParameter.
std::shared_ptr<const Envelope> layer_envelope(const FeltLayer& layer);

/// Number of cached tables of each kind; the oldest one is removed first.
inline constexpr std::size_t kLayerCache = 256;

/// A layer as separate columns, each with its complete memory, including its own transition.
/// `layer_envelope` is the precomputed sum over such columns. Quasi-static.
class LayerColumns {
 public:
  /// @param columns  number of columns, >= 1, spread over compressions up to the layer's end
  /// @param kappa    transition length of each over its loop [-], in (0, 2]
  LayerColumns(const FeltLayer& layer, int columns, double kappa);

  /// Changes the compression to e [m], > 0 in contact; returns the force [N].
  double step(double e);

  /// Restores virgin felt.
  void reset();

 private:
  double thickness_;
  std::shared_ptr<const ContactLaw> law_;
  std::vector<double> gap_, area_;
  std::vector<LawPath> path_;
};

}  // namespace feltmb
