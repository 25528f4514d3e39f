using UnityEngine;

namespace Clothfit
{
    /// <summary>A box, as large as Unity's cube.</summary>
    [AddComponentMenu("Clothfit/Box")]
    public class ClothfitBox : ClothfitObstacle
    {
        public override int Type
        {
            get { return Obstacles.Box; }
        }

        void OnDrawGizmosSelected()
        {
            Gizmos.matrix = transform.localToWorldMatrix;
            Gizmos.color = Color.cyan;
            Gizmos.DrawWireCube(Vector3.zero, Vector3.one);
            Gizmos.matrix = Matrix4x4.identity;
        }
    }
}
