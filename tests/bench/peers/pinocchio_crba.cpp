// Pinocchio's composite-rigid-body algorithm, header-only, behind the same loop as every generated program.
// The model is handed over joint by joint: the URDF parser of the wheel needs urdfdom headers, which it does not bring.
#include <pinocchio/multibody.hpp>
#include <pinocchio/algorithm/crba.hpp>

namespace pin = pinocchio;
using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

static pin::Model model;
static pin::Data data;

// Adds a revolute joint about the unit vector `axis`, at (R, p) in the one before it, and its body. The aligned joint
// types are those that Pinocchio's own parser would choose.
extern "C" void add_joint(const double *axis, const double *R, const double *p, double mass, const double *com,
                          const double *I)
{
  const Eigen::Vector3d a(axis[0], axis[1], axis[2]);
  const pin::SE3 placement{Eigen::Map<const Matrix3>(R), Eigen::Map<const Eigen::Vector3d>(p)};
  const pin::JointIndex parent = model.njoints - 1;
  const std::string name = "joint" + std::to_string(model.njoints);
  pin::JointIndex joint;
  if (a == Eigen::Vector3d::UnitX()) joint = model.addJoint(parent, pin::JointModelRX(), placement, name);
  else if (a == Eigen::Vector3d::UnitY()) joint = model.addJoint(parent, pin::JointModelRY(), placement, name);
  else if (a == Eigen::Vector3d::UnitZ()) joint = model.addJoint(parent, pin::JointModelRZ(), placement, name);
  else joint = model.addJoint(parent, pin::JointModelRevoluteUnaligned(a), placement, name);
  const pin::Inertia body{mass, Eigen::Map<const Eigen::Vector3d>(com), Eigen::Map<const Matrix3>(I)};
  model.appendBodyToJoint(joint, body, pin::SE3::Identity());
  data = pin::Data(model);
}

// out[k]: the upper triangle of M(q[k]), row by row, as crba leaves it (below the diagonal: whatever was there).
extern "C" void run(const double *q, const double *, long count, double *out)
{
  const long n = model.nq;
  Eigen::VectorXd posture(n);
  for (long k = 0; k < count; ++k) {
    posture = Eigen::Map<const Eigen::VectorXd>(q + k * n, n);
    pin::crba(model, data, posture, pin::Convention::LOCAL);
    Eigen::Map<Eigen::MatrixXd>(out + k * n * n, n, n) = data.M;
  }
}
