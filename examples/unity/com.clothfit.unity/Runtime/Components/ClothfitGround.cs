using UnityEngine;

namespace Clothfit
{
    /// <summary>A plane without end through the object, solid on the side of its negative y axis.</summary>
    [AddComponentMenu("Clothfit/Ground")]
    public class ClothfitGround : ClothfitObstacle
    {
        public override int Type
        {
            get { return Obstacles.Plane; }
        }

        void OnDrawGizmosSelected()
        {
            Gizmos.matrix = transform.localToWorldMatrix;
            Gizmos.color = Color.cyan;
            Gizmos.DrawWireCube(Vector3.zero, new Vector3(10f, 0f, 10f));
            Gizmos.matrix = Matrix4x4.identity;
        }
    }
}
