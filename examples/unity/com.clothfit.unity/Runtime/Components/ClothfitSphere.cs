using UnityEngine;

namespace Clothfit
{
    /// <summary>A sphere; its diameter is the object's size along x, as that of Unity's sphere.</summary>
    [AddComponentMenu("Clothfit/Sphere")]
    public class ClothfitSphere : ClothfitObstacle
    {
        public override int Type
        {
            get { return Obstacles.Sphere; }
        }

        void OnDrawGizmosSelected()
        {
            Gizmos.matrix = transform.localToWorldMatrix;
            Gizmos.color = Color.cyan;
            Gizmos.DrawWireSphere(Vector3.zero, 0.5f);
            Gizmos.matrix = Matrix4x4.identity;
        }
    }
}
