using UnityEngine;

namespace Clothfit
{
    /// <summary>A capsule along the object's y axis, as large as Unity's capsule.</summary>
    [AddComponentMenu("Clothfit/Capsule")]
    public class ClothfitCapsule : ClothfitObstacle
    {
        public override int Type
        {
            get { return Obstacles.Capsule; }
        }

        void OnDrawGizmosSelected()
        {
            Gizmos.matrix = transform.localToWorldMatrix;
            Gizmos.color = Color.cyan;
            Gizmos.DrawWireCube(Vector3.zero, new Vector3(1f, 2f, 1f));
            Gizmos.matrix = Matrix4x4.identity;
        }
    }
}
